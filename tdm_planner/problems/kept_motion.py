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
Robots about to arrive keep the motion that their plan has left.

An error across the thrust is corrected by turning the thruster away and back; where there is no
time left for that the rest of the plan is as good as any other, and the feedback about it takes
such errors away. The others plan round a robot that keeps its motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.formation_verification import start_state
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

LATE: Final = 3.0  # half-turns of the thruster before the arrival: away, thrusting, and back
_SAME = np.full(7, 1e-6)  # difference of a start from the plan's that is rounding
_MISSED = np.array([2e-3, 2e-3, 2e-3, 2e-3, 5e-3, 5e-3])  # by which the rest may miss the goal


def turning_time(thruster_rate: float) -> float:
    """Time that half a turn of the thruster takes [s]."""
    return math.pi / thruster_rate


def kept_motions(
    task: FormationTask, plans: Mapping[str, Trajectory], half_turns: float
) -> dict[str, Trajectory]:
    """
    Motions of the robots that are to keep what is left of `plans`, by name.

    They start on their plans, end at their goals, and have less time before them than so many
    `half_turns` of the thruster take.
    """
    leg = half_turns * turning_time(task.thruster_rate)
    found = {}
    for i, name in enumerate(task.names):
        if task.staying[i] or not plans[name].duration < leg:
            continue
        rest = _flown_from(task, i, plans[name])
        if rest is not None:
            found[name] = rest
    return found


def _flown_from(task: FormationTask, robot: int, plan: Trajectory) -> Trajectory | None:
    """Return the plan as flown from the robot's start; None if they differ, or the goals do."""
    start = start_state(task, robot)
    if not (np.abs(plan.states[0] - start) < _SAME).all():
        return None
    begun = replace(plan, states=np.concatenate([start[None], plan.states[1:]]))
    states = task.plant.replay(begun, plan.times)
    if states is None:
        return None
    goal = np.array([*task.goal[robot], 0.0, 0.0, task.goal_yaw[robot], 0.0])
    if not (np.abs(states[-1, :6] - goal) < _MISSED).all():
        return None
    return replace(plan, states=states)
