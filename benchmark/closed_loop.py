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

Every physical constant and actuator gain is off by up to the mismatch, measurements are noisy; no
plan is made anew on the way.

A pendulum counts as held when |theta - 2 pi n| < 0.05 rad and |psi| < psi_max throughout the last
5 s, which begin 2 s after the planned end. Robots count as arrived when every one is within 2 cm
of its goal at its time of arrival and from then on for 5 s after the last arrival, and as
separated when no two have come closer than the minimum separation.
"""

from __future__ import annotations

from functools import partial
import math
from typing import Any

from benchmark.progress import each
from benchmark.scenarios import MINIMUM_SEPARATION
from benchmark.vehicles import (
    ARRIVED,
    crossing_of,
    DISK_ANGLE,
    formation_loop,
    HELD_ANGLE,
    MISMATCH,
    nearest,
    pendulum_loop,
    RIGS,
    ticked,
)
import numpy as np
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.base import Solution
from tdm_planner.tracking import Phase
from tdm_planner.tracking.motion import wrapped

SETTLING, HELD = 2.0, 5.0  # s
ROBOT_INTERVAL = 0.01  # s


def swing_up(
    problem: PendulumSwingUp, solution: Solution, interval: float, mismatch: float, seed: int
) -> dict[str, float]:
    """Track a swing-up; returns what was reached."""
    loop = pendulum_loop(problem, solution, interval, seed, mismatch)
    ticks = math.ceil((solution.duration + SETTLING + HELD) / interval)
    states = np.array([ticked(loop)[0] for _ in range(ticks)])
    count = round(HELD / interval)
    last = states[-count:]
    return {
        'angle': float(np.abs(wrapped(last[:, 0])).max()),
        'disk': float(np.abs(states[:, 1]).max()),
    }


def pendulum(limit: float, reserve: float, interval: float, **options: Any) -> dict[str, Any]:
    """Return how many swing-ups are caught and held."""
    problem = build(PendulumSwingUp, {'limits.torque': limit, 'torque_reserve': reserve})
    solution = problem.solve(deadline=2.0)
    seeds = options['seeds']
    work = partial(swing_up, problem, solution, interval, options['mismatch'])
    runs = each(work, range(seeds), f'pendulum, {limit:g} N m, {interval * 1e3:g} ms')
    held = [run['angle'] < HELD_ANGLE and run['disk'] < DISK_ANGLE for run in runs]
    return {
        'runs': seeds,
        'held': sum(held),
        'duration': solution.duration,
        'angle_median': float(np.median([run['angle'] for run in runs])),
        'angle_worst': max(run['angle'] for run in runs),
        'disk_worst': max(run['disk'] for run in runs),
    }


def tracked_crossing(rig: str, mismatch: float, seed: int) -> dict[str, Any]:
    """Plan the crossing of a seed and track the plans of all robots; returns what was reached."""
    problem = crossing_of(rig, seed)
    solution = problem.solve(deadline=2.0)
    plans = solution.trajectories.values()
    loop = formation_loop(problem, solution, ROBOT_INTERVAL, seed, mismatch)
    ticks = math.ceil((solution.duration + HELD) / ROBOT_INTERVAL)
    places = np.array([ticked(loop)[:, :2] for _ in range(ticks)])
    times = ROBOT_INTERVAL * (np.arange(ticks) + 1)
    planned = np.stack([plan.sample(times).state[:, :2] for plan in plans], axis=1)
    errors = np.linalg.norm(places - planned, axis=2).T
    moving = [times < plan.duration for plan in plans]
    gaps = nearest(places)
    return {
        'arrival': max(float(e[~m][0]) for e, m in zip(errors, moving, strict=True)),
        'held': max(float(e[~m].max()) for e, m in zip(errors, moving, strict=True)),
        'path': [e[m] for e, m in zip(errors, moving, strict=True)],
        'separation': float(gaps.min()),
        'approach': float((nearest(planned) - gaps).max()),
        'stopped': any(v.tracker.phase is Phase.STOPPED for v in loop.vehicles.values()),
    }


def robots(rig: str, **options: Any) -> dict[str, Any]:
    """Return how many crossings of three robots end in formation, without a collision."""
    work = partial(tracked_crossing, rig, options['mismatch'])
    runs = each(work, range(options['seeds']), rig)
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


def run(seeds: int = 40, mismatch: float = MISMATCH) -> dict[str, Any]:
    """Measure everything."""
    options = {'seeds': seeds, 'mismatch': mismatch}
    figures: dict[str, Any] = {'pendulum': {}, 'robots': {}}
    for limit, reserve in ((0.09, 0.2), (0.02, 0.3)):
        for interval in (0.002, 0.005):
            key = f'{limit:g} N m, reserve {reserve:g}, {interval * 1e3:g} ms'
            figures['pendulum'][key] = pendulum(limit, reserve, interval, **options)
    for rig in RIGS:
        figures['robots'][f'{rig}, {1e3 * ROBOT_INTERVAL:g} ms'] = robots(rig, **options)
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
