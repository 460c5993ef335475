# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What can be dragged on the page: every handle sets parameters of a node.

A robot's goal is a pose in the plane, `formation.<robot>` of the planner. The start of the
pendulum is two rings, one an angle: `initial.*` of the simulated plant, which is put there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.problems.formation.parameters import place_in_formation
from tdm_planner.problems.problem import Problem
from tdm_sim.live.geometry import about, axes_of, from_axes

Array = NDArray[np.float64]
Values = Mapping[str, Any]
Pose = tuple[Array, Array]  # place (3,) [m] and rotation wxyz (4,)

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class DragHandle:
    """
    Something to drag, and the parameters of a node that it sets.

    `moves` is `pose` (in the plane, and about the vertical) or `turn` (about its own z). `node` is
    the one whose parameters they are: the planner, or the simulated plant, which is then reset.
    `pose(values)` is where it is for parameters by name; `values_at(pose, values)` are the
    parameters that put it at a pose.
    """

    name: str
    moves: Literal['pose', 'turn']
    node: Literal['planner', 'plant']
    size: float
    pose: Callable[[Values], Pose]
    values_at: Callable[[Pose, Values], dict[str, Any]]


def drag_handles_of(problem: Problem) -> list[DragHandle]:
    """Return the drag handles of a problem's plant."""
    if isinstance(problem, RobotFormation):
        return [_goal(problem, number) for number in range(len(problem.robots))]
    if isinstance(problem, PendulumSwingUp):
        return _starts(problem.plant.arm_length, 2.0 * problem.plant.com_distance)
    return []


def _goal(problem: RobotFormation, number: int) -> DragHandle:
    """Return the handle of a robot's place in the formation."""
    name, task = problem.robots[number], problem.task
    place = np.array([*task.goal[number], 0.0])
    turn = about(UP, float(task.goal_yaw[number]))

    def values_at(pose: Pose, values: Values) -> dict[str, Any]:
        ahead, _, _ = axes_of(pose[1])
        wanted = [float(pose[0][0]), float(pose[0][1]), math.atan2(ahead[1], ahead[0])]
        return {f'formation.{name}': place_in_formation(problem.formation.anchor, wanted)}

    return DragHandle(
        name, 'pose', 'planner', 1.1 * task.separation, lambda values: (place, turn), values_at
    )


def _starts(arm: float, rod: float) -> list[DragHandle]:
    """Return the rings of the pendulum's start: psi about the vertical, theta about the arm."""

    def at(values: Values, name: str) -> float:
        return float(values.get(f'initial.{name}', 0.0))

    def disk(values: Values) -> Pose:
        return np.zeros(3), about(UP, at(values, 'psi'))

    def disk_at(pose: Pose, values: Values) -> dict[str, Any]:
        ahead, _, _ = axes_of(pose[1])
        return {'initial.psi': _nearest(math.atan2(ahead[1], ahead[0]), at(values, 'psi'))}

    def pendulum(values: Values) -> Pose:
        along, across = _arm(at(values, 'psi'))
        theta = at(values, 'theta')
        up = math.cos(theta) * UP + math.sin(theta) * across
        return arm * along, from_axes(up, np.cross(-along, up), -along)

    def pendulum_at(pose: Pose, values: Values) -> dict[str, Any]:
        _, across = _arm(at(values, 'psi'))
        up, _, _ = axes_of(pose[1])
        theta = math.atan2(float(up @ across), float(up @ UP))
        return {'initial.theta': _nearest(theta, at(values, 'theta'))}

    return [
        DragHandle('disk', 'turn', 'plant', 1.5 * arm, disk, disk_at),
        DragHandle('pendulum', 'turn', 'plant', 0.9 * rod, pendulum, pendulum_at),
    ]


def _arm(psi: float) -> tuple[Array, Array]:
    """Return the directions along the arm, and across it as the pendulum falls for theta > 0."""
    c, s = math.cos(psi), math.sin(psi)
    return np.array([c, s, 0.0]), np.array([-s, c, 0.0])


def _nearest(angle: float, before: float) -> float:
    """Return the angle [rad] on the turn that is nearest to what it was."""
    return before + math.remainder(angle - before, math.tau)


def pulled(
    problem: Problem, values: Values, state: Array, start: Sequence[float], end: Sequence[float]
) -> dict[str, Any]:
    """
    Return the plant's parameters with which a push goes where its body was pulled.

    `values` are the plant's parameters, `state` (nx,) is that of the vehicle that was pulled from
    `start` to `end` [m]. None for a plant whose pushes have no direction.
    """
    way = np.subtract(end, start)
    if isinstance(problem, RobotFormation):
        return {'disturbance.direction': math.atan2(way[1], way[0])}
    if isinstance(problem, PendulumSwingUp):
        _, across = _arm(float(state[1]))
        impulse = abs(float(values['disturbance.impulse']))
        return {'disturbance.impulse': math.copysign(impulse, float(way @ across))}
    return {}
