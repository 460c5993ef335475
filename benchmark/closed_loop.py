# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Closed-loop experiments: the trackers' own code against plants that are not their models.

    python -m benchmark.closed_loop [--seeds 40] [--mismatch 0.05]

Every physical constant and actuator gain is off by up to the mismatch, measurements are noisy; no
plan is made anew on the way.

A pendulum counts as held when |theta - 2 pi n| < 0.05 rad and |psi| < psi_max throughout the last
5 s, which begin 2 s after the planned end. Robots count as arrived when every one is within 2 cm
of its goal at its time of arrival and from then on for 5 s after the last arrival, and as
separated when no two have come closer than the minimum separation.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial
import itertools
import math
from typing import Any

from benchmark.parallel import each
from benchmark.scenarios import crossing, MINIMUM_SEPARATION
import numpy as np
from numpy.typing import NDArray
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.base import Solution
from tdm_planner.tracking import (
    PendulumTracker,
    PendulumTrackerParameters,
    Phase,
    RobotTracker,
    RobotTrackerParameters,
    TrajectoryTracker,
)
from tdm_planner.tracking.motion import wrapped
from tdm_planner.trajectory import Trajectory
from tdm_sim.mismatch import mismatched, mismatched_gains
from tdm_sim.simulation import PlantSetup, SimulatedPlant

Array = NDArray[np.float64]

SEEDS = 40
MISMATCH = 0.05
SETTLING, HELD = 2.0, 5.0  # s
HELD_ANGLE, DISK_ANGLE = 0.05, 2.0  # rad
ARRIVED = 0.02  # m
PENDULUM_NOISE = np.array([0.0015, 0.0015, 0.1, 0.1])
ROBOT_NOISE = np.array([0.002, 0.002, 0.002, 0.002, 0.005, 0.005, 0.0])
RIGS: dict[str, tuple[float, float, float]] = {
    # largest thrust [N], thruster rate [rad/s], torque [N m]
    'quick robots': (1.05, 2.0, 0.02),
    'air bearing': (0.315, 0.5, 0.00189),
}


@dataclass
class Loop:
    """A tracker and a plant stepped together."""

    tracker: TrajectoryTracker
    plant: SimulatedPlant
    interval: float

    def begin(self, plan: Trajectory) -> None:
        """Have the plan tracked from the first tick on."""
        self.tracker.observe(self.plant.measure(), -self.interval)
        self.tracker.accept(plan, 0.0, -self.interval)

    def tick(self, now: float) -> Array:
        """Measure, command, move; return the true state after the interval."""
        self.tracker.observe(self.plant.measure(), now)
        self.plant.command(self.tracker.command(now).control)
        self.plant.step(self.interval)
        return self.plant.state


def swing_up(
    plan: Trajectory, limit: float, interval: float, seed: int, mismatch: float
) -> dict[str, float]:
    """Track a swing-up; returns what was reached."""
    values = {'rate': 1.0 / interval, 'limits.torque': limit}
    parameters = build(PendulumTrackerParameters, values)
    setup = PlantSetup(
        plant=mismatched(parameters.plant, mismatch, seed),
        initial=plan.states[0],
        lower=np.array([-limit]),
        upper=np.array([limit]),
        noise=PENDULUM_NOISE,
    )
    loop = Loop(PendulumTracker(parameters), SimulatedPlant(setup, seed), interval)
    loop.begin(plan)
    ticks = math.ceil((plan.duration + SETTLING + HELD) / interval)
    states = np.array([loop.tick(k * interval) for k in range(ticks)])
    count = round(HELD / interval)
    last = states[-count:]
    return {
        'angle': float(np.abs(wrapped(last[:, 0])).max()),
        'disk': float(np.abs(states[:, 1]).max()),
    }


def pendulum(limit: float, reserve: float, interval: float, **options: Any) -> dict[str, Any]:
    """Return how many swing-ups are caught and held."""
    problem = build(PendulumSwingUp, {'limits.torque': limit, 'torque_reserve': reserve})
    plan = problem.solve(deadline=2.0).trajectory
    seeds = options['seeds']
    work = partial(swing_up, plan, limit, interval, mismatch=options['mismatch'])
    runs = each(work, range(seeds), f'pendulum, {limit:g} N m, {interval * 1e3:g} ms')
    held = [run['angle'] < HELD_ANGLE and run['disk'] < DISK_ANGLE for run in runs]
    return {
        'runs': seeds,
        'held': sum(held),
        'duration': plan.duration,
        'angle_median': float(np.median([run['angle'] for run in runs])),
        'angle_worst': max(run['angle'] for run in runs),
        'disk_worst': max(run['disk'] for run in runs),
    }


def robot_loop(
    plan: Trajectory, rig: tuple[float, float, float], interval: float, seed: int, mismatch: float
) -> Loop:
    """Return tracker and plant of one robot."""
    thrust, rate, torque = rig
    values = {
        'rate': 1.0 / interval,
        'limits.thrust': thrust,
        'limits.thruster_rate': rate,
        'limits.torque': torque,
    }
    parameters = build(RobotTrackerParameters, values)
    gains = mismatched_gains(3, mismatch, seed)
    gains[1] = 1.0  # the thruster turns by a servo
    setup = PlantSetup(
        plant=mismatched(parameters.plant, mismatch, seed),
        initial=plan.states[0],
        lower=np.array([0.0, -rate, -torque]),
        upper=np.array([thrust, rate, torque]),
        noise=ROBOT_NOISE,
        gains=gains,
        largest_step=0.005,
    )
    loop = Loop(RobotTracker(parameters), SimulatedPlant(setup, seed), interval)
    loop.begin(plan)
    return loop


def formation(
    solution: Solution,
    rig: tuple[float, float, float],
    interval: float,
    seed: int,
    mismatch: float,
) -> dict[str, Any]:
    """Track the plans of all robots; returns what was reached."""
    plans = list(solution.trajectories.values())
    loops = [
        robot_loop(plan, rig, interval, 100 * seed + number, mismatch)
        for number, plan in enumerate(plans)
    ]
    ticks = math.ceil((solution.duration + HELD) / interval)
    states = np.array([[loop.tick(k * interval) for loop in loops] for k in range(ticks)])
    times = interval * (np.arange(ticks) + 1)
    errors = []
    for number, plan in enumerate(plans):
        offset = states[:, number, :2] - plan.sample(times).state[:, :2]
        errors.append(np.hypot(offset[:, 0], offset[:, 1]))
    moving = [times < plan.duration for plan in plans]
    pairs = itertools.combinations(range(len(plans)), 2)
    gaps = [np.linalg.norm(states[:, i, :2] - states[:, j, :2], axis=1).min() for i, j in pairs]
    planned = solution.trajectory.sample(times).state.reshape(ticks, len(plans), 7)[:, :, :2]
    pairs = itertools.combinations(range(len(plans)), 2)
    wanted = [np.linalg.norm(planned[:, i] - planned[:, j], axis=1).min() for i, j in pairs]
    return {
        'arrival': max(float(e[~m][0]) for e, m in zip(errors, moving, strict=True)),
        'held': max(float(e[~m].max()) for e, m in zip(errors, moving, strict=True)),
        'path': [e[m] for e, m in zip(errors, moving, strict=True)],
        'separation': float(min(gaps)),
        'approach': float(max(np.array(wanted) - np.array(gaps))),
        'stopped': any(loop.tracker.phase is Phase.STOPPED for loop in loops),
    }


def tracked_crossing(name: str, interval: float, mismatch: float, seed: int) -> dict[str, Any]:
    """Plan the crossing of a seed for the rig `name` and track it; returns what was reached."""
    rig = RIGS[name]
    limits = dict(zip(('thrust', 'thruster_rate', 'torque'), rig, strict=True))
    changes = {f'limits.{key}': value for key, value in limits.items()}
    problem = RobotFormation.from_parameters(crossing(seed).parameters(**changes))
    return formation(problem.solve(deadline=2.0), rig, interval, seed, mismatch)


def robots(name: str, interval: float, **options: Any) -> dict[str, Any]:
    """Return how many crossings of three robots end in formation, without a collision."""
    work = partial(tracked_crossing, name, interval, options['mismatch'])
    runs = each(work, range(options['seeds']), name)
    path = np.concatenate([error for run in runs for error in run['path']])
    arrived = [run['held'] < ARRIVED and not run['stopped'] for run in runs]
    return {
        'runs': options['seeds'],
        'arrived': sum(arrived),
        'separated': sum(run['separation'] >= MINIMUM_SEPARATION for run in runs),
        'arrival_worst': max(run['arrival'] for run in runs),
        'held_worst': max(run['held'] for run in runs),
        'path_rms': float(np.sqrt(np.mean(path**2))),
        'path_worst': float(path.max()),
        'separation_least': min(run['separation'] for run in runs),
        'margin_needed': max(run['approach'] for run in runs),
    }


def run(seeds: int = SEEDS, mismatch: float = MISMATCH) -> dict[str, Any]:
    """Measure everything."""
    options = {'seeds': seeds, 'mismatch': mismatch}
    figures: dict[str, Any] = {'pendulum': {}, 'robots': {}}
    for limit, reserve in ((0.09, 0.2), (0.02, 0.3)):
        for interval in (0.002, 0.005):
            key = f'{limit:g} N m, reserve {reserve:g}, {interval * 1e3:g} ms'
            figures['pendulum'][key] = pendulum(limit, reserve, interval, **options)
    for name in RIGS:
        figures['robots'][f'{name}, 10 ms'] = robots(name, 0.01, **options)
    return figures


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    lines = [
        f'{"pendulum":34}{"held":>8}{"plan [s]":>10}{"|theta| med, max":>20}{"|psi| max":>11}'
    ]
    for name, f in figures['pendulum'].items():
        held, angles = (
            f'{f["held"]}/{f["runs"]}',
            f'{f["angle_median"]:.4f} {f["angle_worst"]:.4f}',
        )
        lines.append(f'{name:34}{held:>8}{f["duration"]:10.3f}{angles:>20}{f["disk_worst"]:11.3f}')
    lines.append(
        f'\n{"robots [mm]":22}{"arrived":>9}{"separated":>11}{"arrival max":>13}{"held max":>10}'
        f'{"path rms":>10}{"path max":>10}{"margin needed":>15}'
    )
    for name, f in figures['robots'].items():
        shares = f'{f["arrived"]}/{f["runs"]}', f'{f["separated"]}/{f["runs"]}'
        lengths = [
            1e3 * f[key]
            for key in ('arrival_worst', 'held_worst', 'path_rms', 'path_worst', 'margin_needed')
        ]
        lines.append(
            f'{name:22}{shares[0]:>9}{shares[1]:>11}{lengths[0]:13.1f}{lengths[1]:10.1f}'
            f'{lengths[2]:10.2f}{lengths[3]:10.1f}{lengths[4]:15.1f}'
        )
    return '\n'.join(lines)


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    options.add_argument('--seeds', type=int, default=SEEDS)
    options.add_argument('--mismatch', type=float, default=MISMATCH)
    chosen = options.parse_args()
    print(table(run(chosen.seeds, chosen.mismatch)))


if __name__ == '__main__':
    main()
