# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Closed-loop experiments: the trackers' own code against plants that are not their models.

Every physical constant and actuator gain is off by up to the mismatch, measurements are noisy; no
replan. The flights are those of `tdm study`.

A pendulum counts as held when |theta - 2 pi n| < 0.05 rad and |psi| < psi_max throughout the last
5 s, which begin 2 s after the planned end. Robots count as arrived when every one is within 2 cm
of its goal at its time of arrival and from then on for 5 s after the last arrival, and as
separated when no two have come closer than the minimum separation.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import itertools
from typing import Any

from benchmark.measuring import report
from benchmark.scenarios import (
    ARRIVED,
    crossing_of,
    DISK_ANGLE,
    HELD_ANGLE,
    MINIMUM_SEPARATION,
    MISMATCH,
    RIGS,
)
from distributed import Client
import numpy as np
from tdm_planner.arrays import wrapped
from tdm_planner.parameters import build
from tdm_planner.problems import PendulumSwingUp
from tdm_planner.problems.solution import Solution
from tdm_sim.study import ClosedLoop, each, fly, workers

SETTLING, HELD = 2.0, 5.0  # s


def runs(client: Client, work: Callable[[int], Any], seeds: int, what: str) -> list[Any]:
    """Return what `work` makes of every seed."""
    found = {}
    for seed, result in each(client, work, range(seeds)):
        found[seed] = result
        report(f'{what}: {len(found)} of {seeds}')
    return [found[seed] for seed in range(seeds)]


def swing_up(
    problem: PendulumSwingUp, solution: Solution, how: ClosedLoop, seed: int
) -> dict[str, float]:
    """Track a swing-up; returns what was reached."""
    (vehicle,) = fly(problem, solution, how, seed).vehicles
    settled = solution.duration + SETTLING
    last = vehicle.states.between(settled, settled + HELD)
    return {
        'angle': float(np.abs(wrapped(last.columns['theta'])).max()),
        'disk': float(np.abs(vehicle.states.columns['psi']).max()),
    }


def pendulum(
    client: Client, limit: float, reserve: float, interval: float, seeds: int, mismatch: float
) -> dict[str, Any]:
    """Return how many swing-ups are caught and held."""
    problem = build(PendulumSwingUp, {'limits.torque': limit, 'torque_reserve': reserve})
    solution = problem.solve(deadline=2.0)
    how = ClosedLoop(mismatch=mismatch, rate=1.0 / interval)
    what = f'pendulum, {limit:g} N m, {interval * 1e3:g} ms'
    found = runs(client, partial(swing_up, problem, solution, how), seeds, what)
    held = [run['angle'] < HELD_ANGLE and run['disk'] < DISK_ANGLE for run in found]
    return {
        'runs': seeds,
        'held': sum(held),
        'duration': solution.duration,
        'angle_median': float(np.median([run['angle'] for run in found])),
        'angle_worst': max(run['angle'] for run in found),
        'disk_worst': max(run['disk'] for run in found),
    }


def formation(
    name: str, method: str, interval: float, mismatch: float, seed: int
) -> dict[str, Any]:
    """Plan the crossing of a seed for the rig `name` and track it; returns what was reached."""
    problem = crossing_of(name, seed, method=method)
    solution = problem.solve(deadline=2.0)
    mission = fly(problem, solution, ClosedLoop(mismatch=mismatch, rate=1.0 / interval), seed)
    held, path, gas = [], [], []
    for vehicle, plan in zip(mission.vehicles, solution.trajectories.values(), strict=True):
        thrust = vehicle.controls.between(0.0, solution.duration + HELD).columns['thrust']
        gas.append(float(thrust.sum()) * interval / problem.plant.mass)  # held between commands
        seen = vehicle.states.between(0.0, solution.duration + HELD)
        offset = seen.table(['x', 'y']) - plan.sample(seen.times).state[:, :2]
        error, moving = np.hypot(*offset.T), seen.times < plan.duration
        held.append(error[~moving])
        path.append(error[moving])
    arrivals = np.array([plan.duration for plan in solution.trajectories.values()])
    apart = mission.separations
    planned = {pair: float(column.min()) for pair, column in apart.planned.columns.items()}
    gaps = {pair: float(column.min()) for pair, column in apart.measured.columns.items()}
    return {
        'arrival': max(float(error[0]) for error in held),
        'held': max(float(error.max()) for error in held),
        'path': path,
        'cost': sum(problem.task.cost_terms(arrivals, np.array(gas)).values()),
        'separation': min(gaps.values()),
        'approach': max(planned[pair] - gaps[pair] for pair in gaps),
    }


def robots(
    client: Client, name: str, method: str, interval: float, seeds: int, mismatch: float
) -> dict[str, Any]:
    """Return how many crossings of three robots end in formation, without a collision."""
    work = partial(formation, name, method, interval, mismatch)
    found = runs(client, work, seeds, f'{name}, {method}')
    path = np.concatenate([error for run in found for error in run['path']])
    return {
        'runs': seeds,
        'arrived': sum(run['held'] < ARRIVED for run in found),
        'separated': sum(run['separation'] >= MINIMUM_SEPARATION for run in found),
        'arrival_worst': max(run['arrival'] for run in found),
        'held_worst': max(run['held'] for run in found),
        'path_rms': float(np.sqrt(np.mean(path**2))),
        'path_worst': float(path.max()),
        'cost_mean': float(np.mean([run['cost'] for run in found])),
        'separation_least': min(run['separation'] for run in found),
        'margin_needed': max(run['approach'] for run in found),
    }


def run(seeds: int = 20, mismatch: float = MISMATCH) -> dict[str, Any]:
    """Measure everything."""
    figures: dict[str, Any] = {'pendulum': {}, 'robots': {}}
    with workers() as client:
        for limit, reserve in ((0.09, 0.2), (0.02, 0.3)):
            for interval in (0.002, 0.005):
                key = f'{limit:g} N m, reserve {reserve:g}, {interval * 1e3:g} ms'
                found = pendulum(client, limit, reserve, interval, seeds, mismatch)
                figures['pendulum'][key] = found
        for name, method in itertools.product(RIGS, ('thrust_arcs', 'polynomials')):
            found = robots(client, name, method, 0.01, seeds, mismatch)
            figures['robots'][f'{name}, {method}'] = found
    return figures


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    lines = [
        f'{"pendulum":34}{"held":>8}{"plan [s]":>10}{"|theta| med, max":>20}{"|psi| max":>11}'
    ]
    for name, f in figures['pendulum'].items():
        held = f'{f["held"]}/{f["runs"]}'
        angles = f'{f["angle_median"]:.4f} {f["angle_worst"]:.4f}'
        lines.append(f'{name:34}{held:>8}{f["duration"]:10.3f}{angles:>20}{f["disk_worst"]:11.3f}')
    lines.append(
        f'\n{"robots [mm], 10 ms":26}{"arrived":>9}{"separated":>11}{"arrival max":>13}'
        f'{"held max":>10}{"path rms":>10}{"path max":>10}{"margin needed":>15}{"J flown":>9}'
    )
    for name, f in figures['robots'].items():
        shares = f'{f["arrived"]}/{f["runs"]}', f'{f["separated"]}/{f["runs"]}'
        lines.append(
            f'{name:26}{shares[0]:>9}{shares[1]:>11}'
            f'{1e3 * f["arrival_worst"]:13.1f}{1e3 * f["held_worst"]:10.1f}'
            f'{1e3 * f["path_rms"]:10.2f}{1e3 * f["path_worst"]:10.1f}'
            f'{1e3 * f["margin_needed"]:15.1f}{f["cost_mean"]:9.3f}'
        )
    return '\n'.join(lines)
