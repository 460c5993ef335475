# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Figures of the problem `pendulum_swing_up` on rigs of random constants.

For ranges of the drive (the pendulum's acceleration by the torque over that by gravity): how many
swing-ups from hanging and from random states are verified with default settings in 1 s, and
replans half-way from the rest of the plan, off by what tracking leaves.
"""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from benchmark.measuring import counted, Timed, timed
import numpy as np
from tdm_planner.exceptions import Infeasible
from tdm_planner.plants.rotary_pendulum import PendulumInertia, RotaryPendulum
from tdm_planner.problems import PendulumLimits, PendulumStart, PendulumSwingUp
from tdm_planner.problems.solution import Solution
from tdm_planner.replanning.execution import TimedPlan

DEADLINE = 1.0  # s
DRIVES = (0.0, 0.012, 0.1, 0.3, math.inf)
AWAY = 0.02  # rad, and of w0: standard deviation from the plan half-way


def rig(seed: int, hanging: bool = True) -> PendulumSwingUp:
    """Return the swing-up of a random rig from hanging at rest, or from a random state."""
    rng = np.random.default_rng([seed, 20])

    def spread(least: float, most: float) -> float:
        return float(np.exp(rng.uniform(math.log(least), math.log(most))))

    length = spread(0.06, 2.0)
    arm, mass = length * spread(0.2, 2.0), spread(0.01, 10.0)
    unit = mass * length**2
    across = unit * spread(0.01, 30.0)
    inertia = PendulumInertia(
        disk=unit * spread(0.01, 30.0), x=across, y=across * spread(1e-3, 0.1), z=across
    )
    plant = RotaryPendulum(mass, com_distance=length, arm_length=arm, inertia=inertia)
    torque = mass * plant.gravity * length * spread(0.05, 5.0)
    limits = PendulumLimits(torque=torque, disk_angle=float(rng.uniform(0.8, 4.0)))
    start, w0 = PendulumStart(), plant.natural_frequency
    if not hanging:
        most = np.array([np.pi, 0.5 * limits.disk_angle, 0.5 * w0, 0.5 * w0])
        start = PendulumStart(*(rng.uniform(-1.0, 1.0, 4) * most).tolist())
    return PendulumSwingUp(plant=plant, limits=limits, start=start)


def half_way(problem: PendulumSwingUp, plan: Solution, seed: int) -> Timed:
    """Solve anew from half-way, from a state off the plan, with what is left of it."""
    elapsed, w0 = 0.5 * plan.duration, problem.plant.natural_frequency
    noise = AWAY * np.array([1.0, 1.0, w0, w0])
    state = plan.trajectory.sample(elapsed).state
    state = state + noise * np.random.default_rng(seed).normal(size=4)
    state[1] = np.clip(state[1], -problem.limits.disk_angle, problem.limits.disk_angle)
    moved = replace(problem, start=PendulumStart(*state.tolist()))
    rest = TimedPlan(problem, plan, 0.0).remainder(elapsed)
    return timed(moved, DEADLINE, warm_start=rest)


def summary(results: list[Timed]) -> dict[str, Any]:
    """Return counts, and quantiles of the times of those that gave plans [s]."""
    plans = [result.plan for result in results if result.plan]
    seconds = [result.wall for result in results if result.plan]
    return {
        'cases': len(results),
        'verified': len(plans),
        'infeasible': sum(isinstance(result.error, Infeasible) for result in results),
        'p50_s': float(np.quantile(seconds, 0.5)) if plans else None,
        'p95_s': float(np.quantile(seconds, 0.95)) if plans else None,
        'latest_s': max((result.wall for result in results), default=None),
        'most_arcs': max((plan.parameters.size for plan in plans), default=None),
    }


def run(rigs: int = 200, first: int = 1000) -> dict[str, Any]:
    """Measure everything on the rigs of seeds `first` on."""
    rig(0).prepare()
    figures: dict[str, Any] = {}
    groups: dict[str, dict[str, list[Timed]]] = {}
    for seed in counted(range(first, first + rigs), 'rigs'):
        problem, elsewhere = rig(seed), rig(seed, hanging=False)
        from_hanging, anywhere = timed(problem, DEADLINE), timed(elsewhere, DEADLINE)
        kinds = {'from hanging': from_hanging, 'from random states': anywhere}
        plan = from_hanging.plan
        if plan is not None:
            kinds['replans half-way'] = half_way(problem, plan, seed)
        drive = problem.task.drive
        least = max(edge for edge in DRIVES if edge <= drive)
        for kind, result in kinds.items():
            for group in ('all', f'drive from {least:g}'):
                groups.setdefault(kind, {}).setdefault(group, []).append(result)
    for kind, parts in groups.items():
        figures[kind] = {group: summary(parts[group]) for group in sorted(parts)}
    return figures


def table(figures: dict[str, Any]) -> str:
    """Return the figures as lines of text."""
    head = ('verified', 'infeasible', 'p50 s', 'p95 s', 'latest s', 'most arcs')
    lines = [f'{"":42}' + ''.join(f'{word:>12}' for word in head)]
    for kind, groups in figures.items():
        for group, f in groups.items():
            times = [f[key] for key in ('p50_s', 'p95_s', 'latest_s')]
            words = [f'{f["verified"]}/{f["cases"]}', str(f['infeasible'])]
            words += ['-' if value is None else f'{value:.3f}' for value in times]
            words.append('-' if f['most_arcs'] is None else str(f['most_arcs']))
            lines.append(f'{kind + ", " + group:42}' + ''.join(f'{word:>12}' for word in words))
    return '\n'.join(lines)
