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
from dataclasses import dataclass, replace

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


class PlansInForce:
    """
    The newest published plan, and the one that is carried out until the newest begins.

    A plan that is replaced before it begins is never carried out. May be asked from any thread.
    """

    def __init__(self) -> None:
        self._plans: tuple[PlanInForce, ...] = ()  # in the order of their publication

    def add(self, plan: PlanInForce, now: int) -> None:
        """Take note of a plan published at the instant `now` [ns]."""
        carried_out = self.at(now)
        self._plans = (plan,) if carried_out is None else (carried_out, plan)

    def at(self, now: int) -> PlanInForce | None:
        """Return the plan carried out at the instant `now` [ns]; None before the first begins."""
        return next((plan for plan in reversed(self._plans) if plan.start <= now), None)

    def clock_was_set(self, step: int | None) -> None:
        """Let all begin `step` [ns] later, as the node's clock was set; None: forget them."""
        self._plans = (
            () if step is None else tuple(replace(p, start=p.start + step) for p in self._plans)
        )

    def next_start(self, now: int) -> int | None:
        """Instant [ns] at which the newest plan begins; None where that is not after `now`."""
        start = self._plans[-1].start if self._plans else now
        return start if start > now else None


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
