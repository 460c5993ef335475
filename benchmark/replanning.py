# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Replanning while the plant moves: model errors, noise, a push mid-way, a goal that moves.

    python -m benchmark.replanning [--seeds 40] [--no-replanning] [--air-bearing]

The replanner and the trackers are those of the nodes, reviews at 5 Hz; a plan made from the
states measured at t takes over at t + replan.delay. Physical constants and actuator gains are off
by up to 5 %, measurements are noisy.

The pendulum (limits.torque .02 N m: it must pump) is pushed, half-way through the first plan, by
30 % of the largest angular momentum about its pivot of the planned swing, either way. It is caught
at once when from the first time that the regulator about upright takes over it is never lost
again; it counts as held when |theta - 2 pi n| < .05 rad from 10 s after the start until 15 s after
it.

Of three robots that cross, one is pushed half-way by .05 m/s in a random direction; or the
formation is moved half-way by up to .5 m along each axis and .5 rad. They have arrived when every
one is within 2 cm of its goal throughout the last 3 of 5 s after the last plan's end, and are
separated when no two ever came closer than the minimum separation. Where pushes are to be
expected, plans must leave room for them: arena.tracking_margin is .1 m there.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
import itertools
import math
from typing import Any

from benchmark.closed_loop import ARRIVED, DISK_ANGLE, HELD_ANGLE, RIGS
from benchmark.progress import counted
from benchmark.scenarios import crossing, MINIMUM_SEPARATION
import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.base import Solution
from tdm_planner.problems.request import ReplanParameters
from tdm_planner.problems.swing_up_task import VEHICLE
from tdm_planner.replanning import (
    ActivePlan,
    FormationExecution,
    Replanner,
    SwingUpExecution,
)
from tdm_planner.tracking import (
    PendulumTracker,
    PendulumTrackerParameters,
    Phase,
    RobotTracker,
    RobotTrackerParameters,
)
from tdm_planner.tracking.tracker import wrapped
from tdm_sim.disturbances import pendulum_push, robot_push
from tdm_sim.mismatch import mismatched, mismatched_gains
from tdm_sim.receding import RecedingHorizon, Vehicle
from tdm_sim.simulation import PlantSetup, SimulatedPlant

Array = NDArray[np.float64]

SEEDS, MISMATCH, RATE = 40, 0.05, 5.0
TORQUE, RESERVE, PUSH = 0.02, 0.3, 0.3
PENDULUM_INTERVAL, ROBOT_INTERVAL = 0.005, 0.02  # s
HELD_FROM, HELD_UNTIL = 10.0, 15.0  # s
ROBOT_PUSH, PUSH_MARGIN = 0.05, 0.1  # m/s, m
SETTLING, AT_GOAL = 5.0, 3.0  # s
PENDULUM_NOISE = np.array([0.0015, 0.0015, 0.1, 0.1])
ROBOT_NOISE = np.array([0.002, 0.002, 0.002, 0.002, 0.005, 0.005, 0.0])


def momentum(problem: PendulumSwingUp, states: Array) -> float:
    """Largest angular momentum about the pendulum's pivot along states (n, 4) [N m s]."""
    k = problem.plant.coefficients
    about = k.pendulum * states[:, 2] + k.arm * np.cos(states[:, 0]) * states[:, 3]
    return float(np.abs(about).max())


def pendulum_loop(
    problem: PendulumSwingUp, solution: Solution, seed: int, replanning: bool
) -> RecedingHorizon:
    """Return tracker, plant and replanner of one pendulum."""
    limit = problem.limits.torque
    values = {
        'rate': 1.0 / PENDULUM_INTERVAL,
        'limits.torque': limit,
        'replan.on_deviation': True,
    }
    setup = PlantSetup(
        plant=mismatched(problem.plant, MISMATCH, seed),
        initial=solution.trajectory.states[0],
        lower=np.array([-limit]),
        upper=np.array([limit]),
        noise=PENDULUM_NOISE,
    )
    parameters = build(PendulumTrackerParameters, values)
    tracker = PendulumTracker(parameters)
    replanner = Replanner(SwingUpExecution(problem, parameters), ReplanParameters(rate=RATE))
    loop = RecedingHorizon(
        {VEHICLE: Vehicle(tracker, SimulatedPlant(setup, seed))},
        problem,
        PENDULUM_INTERVAL,
        replanner if replanning else None,
    )
    loop.begin(ActivePlan(problem, solution, 0.0))
    return loop


def swing_up(
    problem: PendulumSwingUp, solution: Solution, seed: int, push: float, replanning: bool
) -> dict[str, Any]:
    """One swing-up, pushed half-way by `push` N m s; returns what was reached."""
    loop = pendulum_loop(problem, solution, seed, replanning)
    tracker, plant = loop.vehicles[VEHICLE]
    true_plant = mismatched(problem.plant, MISMATCH, seed)
    impulse = push * np.random.default_rng([seed, 7]).choice([-1.0, 1.0])
    states, phases = [], []
    for tick in range(round(HELD_UNTIL / PENDULUM_INTERVAL)):
        if tick == round(0.5 * solution.duration / PENDULUM_INTERVAL):
            plant.push(partial(pendulum_push, true_plant, impulse=impulse))
        loop.tick()
        states.append(plant.state)
        phases.append(tracker.phase)
    angle = np.abs(wrapped(np.array(states)[:, 0]))
    away = np.flatnonzero(angle > HELD_ANGLE)
    upright_since = PENDULUM_INTERVAL * (float(away[-1]) + 1.0) if away.size else 0.0
    first = phases.index(Phase.HOLDING) if Phase.HOLDING in phases else len(phases) - 1
    return {
        'at_once': set(phases[first:]) == {Phase.HOLDING} and upright_since < HELD_FROM,
        'held': upright_since < HELD_FROM,
        'upright_since': upright_since,
        'disk': float(np.abs(np.array(states)[:, 1]).max()),
        **_planned(loop),
    }


def _planned(loop: RecedingHorizon) -> dict[str, Any]:
    times = [review.solve_time for review in loop.reviews if review.solve_time > 0.0]
    return {'plans': len(loop.plans), 'refused': len(loop.refusals), 'times': times}


def pendulum(push: float, seeds: int, replanning: bool) -> dict[str, Any]:
    """Swing up and catch, pushed by a share `push` of the swing's largest momentum."""
    problem = build(PendulumSwingUp, {'limits.torque': TORQUE, 'torque_reserve': RESERVE})
    solution = problem.solve(deadline=2.0)
    impulse = push * momentum(problem, solution.trajectory.states)
    what = f'pendulum, pushed by {push:.0%}' if push else 'pendulum'
    runs = [
        swing_up(problem, solution, seed, impulse, replanning)
        for seed in counted(range(seeds), what)
    ]
    return {
        'runs': seeds,
        'at_once': sum(run['at_once'] for run in runs),
        'held': sum(run['held'] for run in runs),
        'slowest': max(run['upright_since'] for run in runs),
        'disk_worst': max(run['disk'] for run in runs),
        'disk_kept': sum(run['disk'] <= DISK_ANGLE for run in runs),
        **_figures(runs),
    }


def _figures(runs: list[dict[str, Any]]) -> dict[str, Any]:
    times = [time for run in runs for time in run['times']] or [0.0]
    return {
        'plans_mean': float(np.mean([run['plans'] for run in runs])),
        'plans_most': max(run['plans'] for run in runs),
        'refused': sum(run['refused'] for run in runs),
        'review_median_ms': 1e3 * float(np.median(times)),
        'review_worst_ms': 1e3 * max(times),
    }


def robot(problem: RobotFormation, initial: Array, seed: int) -> Vehicle:
    """Return tracker and plant of one robot."""
    limits = problem.limits
    values = {
        'rate': 1.0 / ROBOT_INTERVAL,
        'limits.thrust': limits.thrust,
        'limits.thruster_rate': limits.thruster_rate,
        'limits.torque': limits.torque,
        'replan.on_deviation': True,
    }
    parameters = build(RobotTrackerParameters, values)
    gains = mismatched_gains(3, MISMATCH, seed)
    gains[1] = 1.0  # the thruster turns by a servo
    setup = PlantSetup(
        plant=mismatched(parameters.plant, MISMATCH, seed),
        initial=initial,
        lower=np.array([0.0, -limits.thruster_rate, -limits.torque]),
        upper=np.array([limits.thrust, limits.thruster_rate, limits.torque]),
        noise=ROBOT_NOISE,
        gains=gains,
        largest_step=0.01,
    )
    return Vehicle(RobotTracker(parameters), SimulatedPlant(setup, seed))


def moved(problem: RobotFormation, rng: np.random.Generator) -> RobotFormation:
    """Return the same problem with the formation somewhere else, inside the arena."""
    while True:
        shift = rng.uniform(-0.5, 0.5, 3)
        anchor = (np.array(problem.formation.anchor) + shift).tolist()
        try:
            return replace(problem, formation=replace(problem.formation, anchor=anchor))
        except InvalidProblem:
            continue


def formation(
    rig: tuple[float, float, float], seed: int, pushed: bool, replanning: bool
) -> dict[str, Any]:
    """One crossing, with a robot pushed or else the goal moved half-way."""
    limits = dict(zip(('thrust', 'thruster_rate', 'torque'), rig, strict=True))
    changes = {f'limits.{key}': value for key, value in limits.items()}
    if pushed:
        changes['arena.tracking_margin'] = PUSH_MARGIN
    problem = RobotFormation.from_parameters(crossing(seed).parameters(**changes))
    solution = problem.solve(deadline=2.0)
    names = list(solution.trajectories)
    vehicles = {
        name: robot(problem, solution.trajectories[name].states[0], 100 * seed + i)
        for i, name in enumerate(names)
    }
    replanner = Replanner(FormationExecution(problem), ReplanParameters(rate=RATE))
    loop = RecedingHorizon(vehicles, problem, ROBOT_INTERVAL, replanner if replanning else None)
    loop.begin(ActivePlan(problem, solution, 0.0))
    rng = np.random.default_rng([seed, 7])
    places, half_way = [], 0.5 * solution.duration
    while loop.time < loop.plans[-1].end + SETTLING and loop.time < problem.solver.longest:
        if loop.time - ROBOT_INTERVAL < half_way <= loop.time:
            if pushed:
                pushed_robot = vehicles[names[rng.integers(len(names))]].plant
                direction = rng.uniform(-math.pi, math.pi)
                impulse = ROBOT_PUSH * problem.plant.mass
                pushed_robot.push(
                    partial(robot_push, problem.plant, impulse=impulse, direction=direction)
                )
            else:
                loop.problem = moved(problem, rng)
        loop.tick()
        places.append([vehicle.plant.state[:2] for vehicle in vehicles.values()])
    path = np.array(places)
    goals = np.array([p.states[-1, :2] for p in loop.plans[-1].solution.trajectories.values()])
    assert isinstance(loop.problem, RobotFormation)
    reached = np.abs(goals - loop.problem.task.goal).max() < ARRIVED
    count = round(AT_GOAL / ROBOT_INTERVAL)
    last = path[-count:]
    pairs = itertools.combinations(range(len(names)), 2)
    return {
        'arrived': bool(reached and np.linalg.norm(last - goals, axis=2).max() < ARRIVED),
        'separation': min(
            float(np.linalg.norm(path[:, i] - path[:, j], axis=1).min()) for i, j in pairs
        ),
        'late': loop.plans[-1].end - solution.duration,
        **_planned(loop),
    }


def robots(rig: str, pushed: bool, seeds: int, replanning: bool) -> dict[str, Any]:
    """Crossings of three robots, one pushed or the goal moved half-way."""
    what = 'robots, one pushed' if pushed else 'robots, the goal moves'
    runs = [formation(RIGS[rig], seed, pushed, replanning) for seed in counted(range(seeds), what)]
    return {
        'runs': seeds,
        'arrived': sum(run['arrived'] for run in runs),
        'separated': sum(run['separation'] >= MINIMUM_SEPARATION for run in runs),
        'separation_least': min(run['separation'] for run in runs),
        'late_median': float(np.median([run['late'] for run in runs])),
        **_figures(runs),
    }


def run(seeds: int = SEEDS, replanning: bool = True, air_bearing: bool = False) -> dict[str, Any]:
    """Measure everything."""
    rigs = ['quick robots'] + (['air bearing'] if air_bearing else [])
    return {
        'pendulum': {
            'model errors and noise': pendulum(0.0, seeds, replanning),
            'and a push half-way': pendulum(PUSH, seeds, replanning),
        },
        'robots': {
            f'{rig}, {what}': robots(rig, pushed, seeds, replanning)
            for rig in rigs
            for what, pushed in (('one is pushed', True), ('the goal moves', False))
        },
    }


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    planning = f'{"plans mean, most":>18}{"refused":>9}{"review ms med, max":>20}'
    lines = [
        f'{"pendulum":34}{"at once":>9}{"in 10 s":>9}{"slowest":>9}{"|psi| kept":>12}' + planning
    ]
    for name, f in figures['pendulum'].items():
        shares = [f'{f[key]}/{f["runs"]}' for key in ('at_once', 'held', 'disk_kept')]
        lines.append(
            f'{name:34}{shares[0]:>9}{shares[1]:>9}{f["slowest"]:8.2f}s{shares[2]:>12}' + _row(f)
        )
    lines.append(
        f'\n{"robots":34}{"arrived":>9}{"apart":>9}{"nearest":>9}{"later by":>12}' + planning
    )
    for name, f in figures['robots'].items():
        shares = [f'{f[key]}/{f["runs"]}' for key in ('arrived', 'separated')]
        lines.append(
            f'{name:34}{shares[0]:>9}{shares[1]:>9}{f["separation_least"]:8.3f}m'
            f'{f["late_median"]:11.2f}s' + _row(f)
        )
    return '\n'.join(lines)


def _row(f: dict[str, Any]) -> str:
    return (
        f'{f["plans_mean"]:12.1f}{f["plans_most"]:6d}{f["refused"]:9d}'
        f'{f["review_median_ms"]:13.1f}{f["review_worst_ms"]:7.1f}'
    )


def main() -> None:
    """Print the tables."""
    assert __doc__ is not None
    options = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    options.add_argument('--seeds', type=int, default=SEEDS)
    options.add_argument('--no-replanning', action='store_true', help='the first plan is kept')
    options.add_argument('--air-bearing', action='store_true', help='slow robots as well')
    chosen = options.parse_args()
    print(table(run(chosen.seeds, not chosen.no_replanning, chosen.air_bearing)))


if __name__ == '__main__':
    main()
