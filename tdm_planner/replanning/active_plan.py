# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The plan that is being executed, and the part of it still to come."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import TimedTrajectory

Array = NDArray[np.float64]

_SHORTEST = 1e-3  # s; a shorter rest gives no initial guess


@dataclass(frozen=True, eq=False)
class ActivePlan:
    """
    A verified plan and the problem it solves; its motion starts at the instant `start` [s].

    `whole` is the cost of the plan for the whole way, where this one was made on the way; its own
    by default. `own` are the parameters that were given for this plan alone, by name.
    """

    problem: Problem
    solution: Solution
    start: float
    whole: float | None = None
    own: Mapping[str, Any] = field(default_factory=dict)

    @property
    def whole_cost(self) -> float:
        """Cost of the whole way, of which this plan may be the last part."""
        return self.solution.cost if self.whole is None else self.whole

    @property
    def end(self) -> float:
        """Instant at which the last vehicle arrives [s]."""
        return self.start + self.solution.duration

    def motion(self, vehicle: str) -> TimedTrajectory:
        """Return the motion of one vehicle; of a plan for one, whatever it is called."""
        known = vehicle in self.solution.trajectories
        motion = self.solution.trajectories[vehicle] if known else self.solution.trajectory
        return TimedTrajectory(motion, self.start)

    def elapsed(self, time: float) -> float:
        """Time since the start of the motion [s] at an instant [s]."""
        return time - self.start

    def remainder(self, time: float) -> Solution | None:
        """
        Return what is left of the plan at the instant `time` [s], to start a new one from.

        Its trajectories begin at zero again; switching instants and parameters shift with them.
        None before the start and where (nearly) nothing is left.
        """
        elapsed = self.elapsed(time)
        if elapsed < 0.0 or self.solution.duration - elapsed < _SHORTEST:
            return None
        left = {
            name: trajectory.after(min(elapsed, trajectory.duration - _SHORTEST))
            for name, trajectory in self.solution.trajectories.items()
        }
        return replace(self.solution, trajectories=left)
