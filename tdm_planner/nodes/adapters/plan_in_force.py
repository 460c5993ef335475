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

"""Where a plant that is carrying out a plan will be when the next plan takes over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.trajectory import NANOSECOND, Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlanInForce:
    """A published plan; its motion starts at the instant `start` [ns]."""

    trajectory: Trajectory
    start: int

    def reference(self, instant: int) -> Array:
        """Return the planned state (nx,) at an instant [ns]; before and after: that of the end."""
        return self.trajectory.sample((instant - self.start) * NANOSECOND).state


def predicted_start(
    plan: PlanInForce | None,
    state: Array,
    measured: int,
    start: int,
    tracked: Callable[[Array], bool],
    free: Callable[[Array, float], Array],
    deviation: Callable[[Array, Array], Array],
    carried: Callable[[Array, float], Array],
) -> Array:
    """
    Return the state (nx,) at the instant `start` [ns] from one measured at `measured` [ns].

    Where a plan is being followed - its deviation `deviation(state, reference)` satisfies
    `tracked` - the plant will be where that plan leads, plus the deviation as `carried` over the
    time between. Otherwise it moves as `free(state, duration)` says, without control.
    """
    wait = (start - measured) * NANOSECOND
    if plan is not None:
        away = deviation(state, plan.reference(measured))
        if tracked(away):
            return np.asarray(plan.reference(start) + carried(away, wait))
    return free(state, wait)
