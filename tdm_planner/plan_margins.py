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

"""How far a plan stays from every limit, over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.base import Problem
from tdm_planner.trajectory import Trajectory
from tdm_planner.verification import dense_times

Array = NDArray[np.float64]

_INSTANTS = 1000


@dataclass(frozen=True, eq=False)
class PlanMargin:
    """Margin of a constraint at `times` (n,) s, `values` (n,): negative where it is violated."""

    name: str
    unit: str
    times: Array
    values: Array


def plan_margins(problem: Problem, trajectory: Trajectory) -> tuple[PlanMargin, ...]:
    """Return the margin of every constraint that the problem puts on one vehicle's motion."""
    times = dense_times(trajectory, trajectory.duration / _INSTANTS)
    states, controls = trajectory.sample(times)
    return tuple(
        PlanMargin(c.name, c.unit, times, np.asarray(c.margin(times, states, controls)))
        for c in problem.constraints_on(trajectory)
    )
