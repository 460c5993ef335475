# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
The check of a formation's plan on the replayed states: every robot, and all pairs together.

Also the penalty (10), (29) of Yakimenko (2006) with its slips mended: half a separation is kept
from the walls, all pairs count until the last robot has arrived, and thrust, torque and thruster
rate have their terms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import itertools

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import check, Constraint, judge, replay, Verification

Array = NDArray[np.float64]

TERMINAL_TOLERANCE = np.array([3.5e-3, 3.5e-3, 5e-3, 5e-3, 1e-2, 1e-2, np.inf])
_RESOLUTION = 0.01
_ROUNDING = 1e-6
_CONSISTENCY = np.full(7, 1e-5)


@dataclass(frozen=True)
class FormationVerification:
    """Checks of every robot by name, of all together, and the penalty."""

    robots: Mapping[str, Verification]
    overall: Verification
    penalty: float

    @property
    def ok(self) -> bool:
        """Whether everything holds."""
        return self.overall.ok


def verify_formation(
    task: FormationTask, trajectories: Mapping[str, Trajectory], penalty_weights: Array
) -> FormationVerification:
    """
    Replay every robot, then check all pairs at equal times, 10 ms apart.

    `penalty_weights` (4,) are k1 to k4 of (29).
    """
    flights = _flights(task, trajectories)
    robots = {
        name: judge(
            task.plant,
            trajectories[name],
            *flights[name],
            np.array([*task.goal[i], 0.0, 0.0, task.goal_yaw[i], 0.0, 0.0]),
            TERMINAL_TOLERANCE,
            robot_constraints(task),
            consistency=_CONSISTENCY,
            start=start_state(task, i),
        )
        for i, name in enumerate(task.names)
    }
    times, states, controls = _side_by_side(task, trajectories, flights)
    separations = separation_constraints(task)
    pairs, pair_times, violated = check(separations, times, states, controls)
    reasons = [f'{name}: {reason}' for name in task.names for reason in robots[name].reasons]
    worst = {f'{name}.{k}': v for name in task.names for k, v in robots[name].worst.items()}
    instants = {
        f'{name}.{k}': v for name in task.names for k, v in robots[name].worst_times.items()
    }
    units = {f'{name}.{k}': v for name in task.names for k, v in robots[name].units.items()}
    overall = Verification(
        ok=not (reasons or violated),
        terminal_error=np.concatenate([robots[name].terminal_error for name in task.names]),
        worst=worst | pairs,
        worst_times=instants | pair_times,
        reasons=(*violated, *reasons),
        state_names=tuple(f'{name}.{s}' for name in task.names for s in task.plant.state_names),
        units=units | {constraint.name: constraint.unit for constraint in separations},
    )
    return FormationVerification(robots, overall, penalty(task, states, controls, penalty_weights))


def start_state(task: FormationTask, robot: int) -> Array:
    """State (7,) of a robot to begin in, NaN where the thruster's angle is free."""
    return np.array(
        [
            *task.start[robot],
            *task.velocity[robot],
            task.yaw[robot],
            task.yaw_rate[robot],
            task.alpha[robot],
        ]
    )


def keeps_reserve(task: FormationTask, verification: Verification) -> bool:
    """
    Whether at least half of the distance reserved for tracking is left between all pairs.

    A thruster that turns slowly lets robots deviate from the motions that were planned.
    """
    i, j = np.triu_indices(task.n, 1)
    reserved = np.minimum(task.pair_clearances(i, j) - task.separation, task.margin)
    left = [
        verification.worst[f'separation {task.names[a]}-{task.names[b]}']
        for a, b in zip(i, j, strict=True)
    ]
    return bool((np.array(left) >= 0.5 * reserved).all())


def _common_instants(trajectories: Mapping[str, Trajectory]) -> Array:
    last = max(trajectory.duration for trajectory in trajectories.values())
    return np.linspace(0.0, last, int(np.ceil(last / _RESOLUTION)) + 1)


def _flights(
    task: FormationTask, trajectories: Mapping[str, Trajectory]
) -> dict[str, tuple[Array, Array]]:
    """Every robot replayed: the common instants until its arrival and its samples, the states."""
    times = _common_instants(trajectories)
    found = {}
    for name in task.names:
        trajectory = trajectories[name]
        own = np.union1d(times[times <= trajectory.duration], trajectory.times)
        found[name] = own, replay(task.plant, trajectory, own)
    return found


def _side_by_side(
    task: FormationTask,
    trajectories: Mapping[str, Trajectory],
    flights: Mapping[str, tuple[Array, Array]],
) -> tuple[Array, Array, Array]:
    times = _common_instants(trajectories)
    states, controls = [], []
    for name in task.names:
        own, flown = flights[name]
        states.append(flown[np.minimum(np.searchsorted(own, times), own.size - 1)])
        under_way = times <= trajectories[name].duration
        controls.append(trajectories[name].controls_at(times) * under_way[:, None])
    return times, np.concatenate(states, axis=1), np.concatenate(controls, axis=1)


def robot_constraints(task: FormationTask) -> list[Constraint]:
    """Limits of one robot: thrust, thruster rate, torque, walls, keep-out zones."""
    plant = task.plant
    thrust, torque = task.thrust * plant.mass, task.torque * plant.inertia
    half = task.separation / 2

    def walls(times: Array, states: Array, controls: Array) -> Array:
        place = states[:, :2]
        return np.asarray(np.minimum(place, task.sides - place).min(axis=1) - half)

    constraints = [
        Constraint(
            'thrust',
            lambda t, x, u: np.minimum(thrust - u[:, 0], u[:, 0]),
            _ROUNDING * thrust,
            'N',
        ),
        Constraint(
            'thruster_rate',
            lambda t, x, u: task.thruster_rate - np.abs(u[:, 1]),
            _ROUNDING * task.thruster_rate,
            'rad/s',
        ),
        Constraint('torque', lambda t, x, u: torque - np.abs(u[:, 2]), _ROUNDING * torque, 'N m'),
        Constraint('walls', walls, _ROUNDING, 'm'),
    ]
    if len(task.obstacles):
        constraints.append(
            Constraint('keep_out', lambda t, x, u: _zone_margin(task, x[:, :2]), _ROUNDING, 'm')
        )
    return constraints


def _zone_margin(task: FormationTask, place: Array) -> Array:
    apart = np.linalg.norm(place[:, None] - task.obstacles[:, :2], axis=2)
    return np.asarray((apart - task.obstacles[:, 2]).min(axis=1) - task.separation / 2)


def separation_constraints(task: FormationTask) -> list[Constraint]:
    """Return the separation of every pair, on the states of all robots side by side."""

    def margin(i: int, j: int) -> Callable[[Array, Array, Array], Array]:
        def of(times: Array, states: Array, controls: Array) -> Array:
            every = states.reshape(len(states), -1, 7)
            apart = every[:, i, :2] - every[:, j, :2]
            return np.asarray(np.hypot(apart[:, 0], apart[:, 1]) - task.separation)

        return of

    return [
        Constraint(
            f'separation {task.names[i]}-{task.names[j]}',
            margin(i, j),
            _ROUNDING,
            'm',
        )
        for i, j in itertools.combinations(range(task.n), 2)
    ]


def penalty(task: FormationTask, states: Array, controls: Array, weights: Array) -> float:
    """
    Return Delta of (10): k1 to k4 times the squares of the largest violations.

    k1: walls and keep-out zones [m^2]; k2: thrust, k3: torque and thruster rate, relative to
    their limits; k4: separations of all pairs [m^2]. Robots' and pairs' terms are summed.
    """

    def excess(margin: Array) -> float:
        return float(np.square(np.maximum(-margin, 0.0)).max())

    terms = np.zeros(4)
    plant = task.plant
    every_state = states.reshape(len(states), -1, 7)
    every_control = controls.reshape(len(controls), -1, 3)
    for i in range(task.n):
        x, u = every_state[:, i], every_control[:, i]
        place = x[:, :2]
        for side in (place, task.sides - place):
            terms[0] += sum(excess(side[:, axis] - task.separation / 2) for axis in range(2))
        if len(task.obstacles):
            terms[0] += excess(_zone_margin(task, place))
        push = u[:, 0] / (plant.mass * task.thrust)
        terms[1] += excess(np.minimum(1.0 - push, push))
        terms[2] += excess(1.0 - np.abs(u[:, 2]) / (plant.inertia * task.torque))
        terms[2] += excess(1.0 - np.abs(u[:, 1]) / task.thruster_rate)
    for constraint in separation_constraints(task):
        terms[3] += excess(constraint.margin(states[:, 0], states, controls))
    # What is less than rounding of the time stamps explains is no violation.
    return float(weights @ np.where(terms < 1e-16, 0.0, terms))
