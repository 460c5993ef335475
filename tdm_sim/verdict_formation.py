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

"""Did every robot reach its place and hold it, and did none come too close? From measurements."""

from __future__ import annotations

from collections.abc import Mapping
import itertools
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from tdm_planner.measured_robot import MeasuredRobot, pair_distance
from tdm_planner.trajectory import Trajectory
from tdm_sim.verdict import ends_early, held_from, HOLD_TIME, planned_instants, Verdict

Array = NDArray[np.float64]

POSITION_TOLERANCE = 0.02
YAW_TOLERANCE = 0.03
LONGEST_SETTLING = 8.0


class Arena(Protocol):
    """What of the surroundings counts: sides, and the separation to be kept [m]."""

    @property
    def length(self) -> float:
        """Extent along x."""

    @property
    def width(self) -> float:
        """Extent along y."""

    @property
    def separation(self) -> float:
        """Smallest distance of two robots; half of it is to be kept from the walls."""


def place_errors(robot: MeasuredRobot, goal: Array) -> tuple[Array, Array]:
    """Return the distances from the goal (x, y, yaw) [m] and the errors of yaw [rad], (n,)."""
    columns = robot.columns
    distance = np.hypot(columns['x'] - goal[0], columns['y'] - goal[1])
    turned = columns['yaw'] - goal[2]
    return distance, np.abs(np.arctan2(np.sin(turned), np.cos(turned)))


def arrived_since(robot: MeasuredRobot, goal: Array) -> float:
    """Return the instant [s] from which the robot stays within the tolerances; inf if none."""
    distance, turn = place_errors(robot, goal)
    worst = np.maximum(distance / POSITION_TOLERANCE, turn / YAW_TOLERANCE)
    return held_from(robot.times, worst, 1.0)


def _due(plan: Trajectory, goal: Array) -> float:
    """Return the instant [s] from which the plan itself stays within the tolerances."""
    instants = planned_instants(plan)
    states = plan.sample(instants).state
    columns = dict(zip(plan.state_names, states.T, strict=True))
    return arrived_since(MeasuredRobot(instants, columns), goal)


def judge_formation(
    view: Arena,
    plans: Mapping[str, Trajectory],
    goals: Mapping[str, Array],
    measured: Mapping[str, MeasuredRobot],
    solve_time: float,
) -> Verdict:
    """Judge robots' motions: in place soon after the plan's end, held, and never too close."""
    reasons: list[str] = []
    rows: list[tuple[str, str, str]] = []
    ends: list[float] = []
    for name, plan in plans.items():
        robot, goal = measured[name], goals[name]
        since, end = arrived_since(robot, goal), float(robot.times[-1])
        late = not since <= plan.duration + LONGEST_SETTLING
        distance, turn = place_errors(robot, goal)
        last = robot.times > robot.times[-1] - HOLD_TIME
        if late and end > plan.duration + LONGEST_SETTLING:
            reasons.append(
                f'{name} was not in its place within {LONGEST_SETTLING:g} s of the planned arrival'
            )
        elif late or end - max(since, 0.0) < HOLD_TIME:
            ends.append(end)
        rows += [
            (f'{name}: duration of the plan [s]', f'{plan.duration:.2f}', ''),
            (f'{name}: in its place from [s]', f'{_due(plan, goal):.2f}',
             f'{max(since, 0.0):.2f}'),
            (f'{name}: error at the end [mm]', f'< {1e3 * POSITION_TOLERANCE:g}',
             f'{1e3 * distance[last].max():.1f}'),
            (f'{name}: yaw error at the end [rad]', f'< {YAW_TOLERANCE:g}',
             f'{turn[last].max():.4f}'),
        ]  # fmt: skip
    for check in (_distances, _walls):
        found, row = check(view, plans, measured)
        reasons += found
        rows += row
    rows.append(('time to solve [ms]', f'{1e3 * solve_time:.0f}', ''))
    undecided = ends_early(min(ends)) if ends and not reasons else ''
    return Verdict(tuple(reasons), tuple(rows), undecided)


def _distances(
    view: Arena, plans: Mapping[str, Trajectory], measured: Mapping[str, MeasuredRobot]
) -> tuple[list[str], list[tuple[str, str, str]]]:
    if len(plans) < 2:
        return [], []
    reasons, planned, achieved = [], math.inf, math.inf
    end = max(plan.duration for plan in plans.values())
    times = np.linspace(0.0, end, int(end / 0.01) + 2)
    for one, other in itertools.combinations(plans, 2):
        apart = plans[one].sample(times).state[:, :2] - plans[other].sample(times).state[:, :2]
        planned = min(planned, float(np.linalg.norm(apart, axis=1).min()))
        nearest = float(pair_distance(measured[one], measured[other])[1].min(initial=math.inf))
        achieved = min(achieved, nearest)
        if not nearest >= view.separation:
            reasons.append(
                f'{one} and {other} came within {nearest:.3f} m of each other, '
                f'{view.separation:g} m must be kept'
            )
    row = ('smallest distance [m]', f'{planned:.3f}', f'{achieved:.3f}')
    return reasons, [row]


def _walls(
    view: Arena, plans: Mapping[str, Trajectory], measured: Mapping[str, MeasuredRobot]
) -> tuple[list[str], list[tuple[str, str, str]]]:
    def room(x: Array, y: Array) -> float:
        sides = (x, view.length - x, y, view.width - y)
        return min(float(side.min()) for side in sides)

    reasons, planned, achieved = [], math.inf, math.inf
    for name, plan in plans.items():
        planned = min(planned, room(plan.state('x'), plan.state('y')))
        nearest = room(measured[name].columns['x'], measured[name].columns['y'])
        achieved = min(achieved, nearest)
        if not nearest >= view.separation / 2:
            reasons.append(
                f'{name} came within {nearest:.3f} m of a wall, {view.separation / 2:g} m must be '
                'kept'
            )
    return reasons, [('smallest distance from a wall [m]', f'{planned:.3f}', f'{achieved:.3f}')]
