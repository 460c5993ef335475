# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The check of a formation's plan on the replayed states: every robot, and all pairs together.

Also the penalty (10), (29) of Yakimenko (2006) with its slips mended: half a separation is kept
from the walls, all pairs count until the last robot has arrived, and thrust, torque and thruster
rate have their terms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import itertools
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.robot_replay import replay
from tdm_planner.problems.formation.parameters import FormationParameters
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Interpolation, Trajectory
from tdm_planner.verification import check, Constraint, even_times, judge, Verification

TERMINAL_TOLERANCE = np.array([3.5e-3, 3.5e-3, 5e-3, 5e-3, 1e-2, 1e-2, np.inf])
_RESOLUTION = 0.01  # s, at most,
_MISSED = 1e-4  # m by which robots may come nearer between two instants
_ROUNDING = 1e-6
# Messages tell of rates below 1e-3 at the end as zero.
_CONSISTENCY = np.array([1e-5, 1e-5, 1e-3, 1e-3, 1e-5, 1e-3, 1e-5])


def gas_used(plant: FloatingRobot, trajectory: Trajectory) -> float:
    """Integral of thrust per mass along a robot's trajectory [m/s]."""
    thrust = trajectory.control_names.index('thrust')
    return float(trajectory.control_integral(trajectory.times[-1])[thrust]) / plant.mass


def assessed(
    task: FormationTask,
    settings: FormationParameters,
    motions: Mapping[str, Trajectory],
    parameters: Array,
) -> Solution:
    """
    Return the robots' motions with their check and cost; `parameters` are Xi (m,).

    Every robot is replayed, then all pairs are looked at together, at equal times 10 ms apart, or
    less where robots are so fast that they could come nearer between them.
    """
    tolerance = settings.solver.tolerance
    motions = {name: motions[name] for name in task.names}
    for name, motion in motions.items():
        if motion.rates is None:
            motions[name] = motion.with_rates(task.plant.derivative)
    last = max(motion.duration for motion in motions.values())
    # In a step h at a relative speed v the distance d of two robots falls by (v h)^2 / (8 d).
    speed = 2.0 * max(np.hypot(m.state('u'), m.state('v')).max() for m in motions.values())
    step = math.sqrt(8.0 * task.separation * _MISSED) / max(speed, 1e-9)
    times = even_times(0.0, last, min(step, _RESOLUTION))
    limits, robots, every_state = robot_constraints(task), {}, []
    for i, name in enumerate(task.names):
        motion = motions[name]
        own = np.union1d(times[times <= motion.duration], motion.times)
        replayed = replay(task.plant, motion, own)
        robots[name] = judge(
            task.plant,
            motion,
            own,
            replayed,
            goal_state(task, i),
            TERMINAL_TOLERANCE,
            limits,
            consistency=_CONSISTENCY,
            start=start_state(task, i),
        )
        every_state.append(replayed[np.minimum(np.searchsorted(own, times), own.size - 1)])
    separations = separation_constraints(task)
    pairs, pair_times, violated = check(
        separations, times, np.concatenate(every_state, axis=1), np.zeros((times.size, 0))
    )
    worst = [each.worst for each in robots.values()]
    left = penalty(task, worst, pairs, np.array(settings.weights.penalty))
    reasons = [f'{name}: {reason}' for name in task.names for reason in robots[name].reasons]
    if left > tolerance:
        reasons.append(f'the penalty {left:.3g} is above solver.tolerance = {tolerance:g}')

    def together(field: str) -> dict[str, Any]:
        found = {name: getattr(robots[name], field) for name in task.names}
        return {f'{name}.{k}': value for name in found for k, value in found[name].items()}

    overall = Verification(
        ok=not (reasons or violated),
        terminal_error=np.concatenate([robots[name].terminal_error for name in task.names]),
        worst=together('worst') | pairs,
        worst_times=together('worst_times') | pair_times,
        reasons=(*violated, *reasons),
        state_names=tuple(f'{name}.{s}' for name in task.names for s in task.plant.state_names),
        units=together('units') | {each.name: each.unit for each in separations},
    )
    terms = task.cost_terms(
        np.array([motions[name].duration for name in task.names]),
        np.array([gas_used(task.plant, motions[name]) for name in task.names]),
    )
    return Solution(
        trajectories=motions,
        verification=overall,
        cost=sum(terms.values()),
        parameters=parameters,
        penalty=left,
        cost_terms=terms,
        verifications=robots,
    )


def start_state(task: FormationTask, robot: int) -> Array:
    """State (7,) of a robot to begin in, NaN where the thruster's angle is free."""
    turned = task.yaw[robot], task.yaw_rate[robot], task.alpha[robot]
    return np.array([*task.start[robot], *task.velocity[robot], *turned])


def goal_state(task: FormationTask, robot: int) -> Array:
    """State (7,) of a robot to end in; the thruster's angle is free."""
    return np.array([*task.goal[robot], 0.0, 0.0, task.goal_yaw[robot], 0.0, 0.0])


def flown(
    task: FormationTask,
    robot: int,
    times: Array,
    controls: Array,
    alpha: float,
    interpolation: Interpolation,
) -> Trajectory:
    """
    Return a robot's motion under `controls` (N, 3), those of the plant, its states integrated.

    The thruster begins at the angle `alpha` [rad].
    """
    plant, states = task.plant, np.zeros((times.size, 7))
    states[0] = start_state(task, robot)
    states[0, 6] = alpha
    draft = Trajectory.of(plant, times, states, controls, interpolation)
    return replace(draft, states=replay(plant, draft, times))


def keeps_reserve(task: FormationTask, verification: Verification) -> bool:
    """
    Whether at least half of the distance reserved for tracking is left between all pairs.

    A thruster that turns slowly lets robots deviate from the motions that were planned.
    """
    reserved = task.pair_clearances() - task.separation
    left = [verification.worst[pair.name] for pair in separation_constraints(task)]
    return bool((np.array(left) >= 0.5 * np.minimum(reserved, task.margin)).all())


def robot_constraints(task: FormationTask) -> list[Constraint]:
    """Limits of one robot: thrust, thruster rate, torque, walls, keep-out zones."""
    plant, rate, half = task.plant, task.thruster_rate, task.separation / 2
    thrust, torque = task.thrust * plant.mass, task.torque * plant.inertia

    def walls(times: Array, states: Array, controls: Array) -> Array:
        nearest = np.minimum(states[:, :2], task.sides - states[:, :2])
        return np.asarray(nearest.min(axis=1) - half)

    def keep_out(times: Array, states: Array, controls: Array) -> Array:
        apart = np.linalg.norm(states[:, None, :2] - task.obstacles[:, :2], axis=-1)
        return np.asarray((apart - task.obstacles[:, 2]).min(axis=-1) - half)

    limits: list[tuple[str, Callable[[Array, Array, Array], Array], float, str]] = [
        ('thrust', lambda t, x, u: np.minimum(thrust - u[:, 0], u[:, 0]), thrust, 'N'),
        ('thruster_rate', lambda t, x, u: rate - abs(u[:, 1]), rate, 'rad/s'),
        ('torque', lambda t, x, u: torque - abs(u[:, 2]), torque, 'N m'),
        ('walls', walls, 1.0, 'm'),
    ]
    if len(task.obstacles):
        limits.append(('keep_out', keep_out, 1.0, 'm'))
    return [Constraint(name, of, _ROUNDING * size, unit) for name, of, size, unit in limits]


def separation_constraints(task: FormationTask) -> list[Constraint]:
    """Return the separation of every pair, on the states of all robots side by side."""

    def margin(i: int, j: int) -> Callable[[Array, Array, Array], Array]:
        one, other = (slice(7 * k, 7 * k + 2) for k in (i, j))
        return lambda t, x, u: np.hypot(*(x[:, one] - x[:, other]).T) - task.separation

    return [
        Constraint(f'separation {task.names[i]}-{task.names[j]}', margin(i, j), _ROUNDING, 'm')
        for i, j in itertools.combinations(range(task.n), 2)
    ]


def penalty(
    task: FormationTask,
    robots: Iterable[Mapping[str, float]],
    pairs: Mapping[str, float],
    weights: Array,
) -> float:
    """
    Return Delta of (10): k1 to k4 times the squares of the largest violations, summed.

    They follow from the worst margins by name, of the robots' own limits and of all pairs. k1:
    walls and keep-out zones [m^2]; k2: thrust, k3: torque and thruster rate, relative to their
    limits; k4: separations [m^2].
    """
    kinds = {
        'walls': (0, 1.0),
        'keep_out': (0, 1.0),
        'thrust': (1, task.plant.mass * task.thrust),
        'torque': (2, task.plant.inertia * task.torque),
        'thruster_rate': (2, task.thruster_rate),
    }
    terms = np.zeros(4)
    for worst in robots:
        for name, margin in worst.items():
            term, unit = kinds[name]
            terms[term] += min(margin / unit, 0.0) ** 2
    terms[3] = sum(min(margin, 0.0) ** 2 for margin in pairs.values())
    # What is less than rounding of the time stamps explains is no violation.
    return float(weights @ np.where(terms < 1e-16, 0.0, terms))
