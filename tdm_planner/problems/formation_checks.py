# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whether a manoeuvre can be asked for at all: one clear sentence for what contradicts."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.problems.formation_task import FormationTask

Array = NDArray[np.float64]

_ROUNDING = 1e-9


def check_task(task: FormationTask) -> None:
    """
    Check arena, starts and goals.

    Raises
    ------
    InvalidProblem
        Naming robot or parameter, the value and what is allowed.

    """
    for name, inertia, acceleration in (
        ('thrust', 'mass', task.thrust),
        ('torque', 'inertia', task.torque),
    ):
        if not acceleration > 0.0:
            raise InvalidProblem(
                f"parameter 'limits.{name}' is too small beside 'plant.{inertia}': the "
                'acceleration it gives must be above 0'
            )
    _check_arena(task)
    for place, points in (('start', task.start), ('goal', task.goal)):
        _check_walls(task, place, points)
        _check_zones(task, place, points)
        _check_separation(task, place, points)
    _check_reach(task)


def _check_arena(task: FormationTask) -> None:
    for name, side in (('length', task.length), ('width', task.width)):
        if side < task.separation:
            raise InvalidProblem(
                f"parameter 'arena.{name}' = {side:g} is not allowed: must be at least "
                f'arena.minimum_separation = {task.separation:g} m'
            )
    for x, y, radius in task.obstacles:
        if radius <= 0:
            raise InvalidProblem(
                f"parameter 'arena.obstacles' holds radius {radius:g} at ({x:g}, {y:g}): must be "
                'in (0, inf) m'
            )


def _check_walls(task: FormationTask, place: str, points: Array) -> None:
    half = task.separation / 2
    for name, point in zip(task.names, points, strict=True):
        for axis, value, side in zip('xy', point, task.sides, strict=True):
            if not half - _ROUNDING <= value <= side - half + _ROUNDING:
                raise InvalidProblem(
                    f"{place} of '{name}' has {axis} = {value:.4g} m, outside the arena: must be "
                    f'in [{half:g}, {side - half:g}] m (half of arena.minimum_separation from '
                    'the walls)'
                )


def _check_zones(task: FormationTask, place: str, points: Array) -> None:
    for name, point in zip(task.names, points, strict=True):
        for x, y, radius in task.obstacles:
            least = radius + task.separation / 2
            distance = float(np.hypot(point[0] - x, point[1] - y))
            if distance < least - _ROUNDING:
                raise InvalidProblem(
                    f"{place} of '{name}' is {distance:.4g} m from the centre of the keep-out "
                    f'zone at ({x:g}, {y:g}) (arena.obstacles): must be at least {least:g} m'
                )


def _check_separation(task: FormationTask, place: str, points: Array) -> None:
    for i, j in itertools.combinations(range(task.n), 2):
        distance = float(np.linalg.norm(points[i] - points[j]))
        if distance < task.separation - _ROUNDING:
            raise InvalidProblem(
                f"{place}s of '{task.names[i]}' and '{task.names[j]}' are {distance:.4g} m apart: "
                f'must be at least arena.minimum_separation = {task.separation:g} m'
            )


def least_time(way: Array, rate: Array, acceleration: float) -> Array:
    """
    Shortest time [s] to cover `way` (n,) on a line and stop, from the rate `rate` (n,).

    The double integrator's bang-bang time: speed up and brake, or brake and come back.
    """
    way, rate = np.where(way < 0, -way, way), np.where(way < 0, -rate, rate)
    overshoot = rate * np.abs(rate) / (2 * acceleration) - way
    peak = np.sqrt(np.maximum(acceleration * way + rate**2 / 2, 0.0))
    direct = (2 * peak - rate) / acceleration
    back = rate / acceleration + 2 * np.sqrt(np.maximum(overshoot, 0.0) / acceleration)
    return np.where(overshoot > 0, back, direct)


def _check_reach(task: FormationTask) -> None:
    """Return a lower bound of every arrival: along the straight way alone, and of the turn."""
    away = task.goal - task.start
    way = np.linalg.norm(away, axis=1)
    speed = np.linalg.norm(task.velocity, axis=1)
    along = (task.velocity * away).sum(axis=1) / np.maximum(way, 1e-12)
    straight = least_time(way, along, task.thrust)
    moving = np.maximum(straight, speed / task.thrust)
    turning = least_time(task.goal_yaw - task.yaw, task.yaw_rate, task.torque)
    least = np.maximum(moving, turning)
    if least.max(initial=0.0) > task.longest:
        robot = int(np.argmax(least))
        raise InvalidProblem(
            f"goal of '{task.names[robot]}' cannot be reached within solver.longest = "
            f'{task.longest:g} s: at least {least[robot]:.3g} s are needed with limits.thrust and '
            'limits.torque'
        )
