# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where a plant that is carrying out a plan will be when the next plan takes over."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from tdm_planner.trajectory import NANOSECOND, TimedTrajectory, Trajectory

Array = NDArray[np.float64]


class ActivePlans:
    """
    The newest published plan, and the one that is carried out until the newest begins.

    A plan that is replaced before it begins is never carried out. May be asked from any thread;
    instants are nanoseconds of the node's clock.
    """

    def __init__(self) -> None:
        self._plans: tuple[tuple[Trajectory, int], ...] = ()  # in the order of publication

    def add(self, trajectory: Trajectory, start: int, now: int) -> None:
        """Take note of a plan published at the instant `now`; its motion begins at `start`."""
        carried_out = self._at(now)
        self._plans = (*(() if carried_out is None else (carried_out,)), (trajectory, start))

    def at(self, now: int) -> TimedTrajectory | None:
        """Return the plan carried out, its instants [s] from `now`; None before the first."""
        found = self._at(now)
        return None if found is None else TimedTrajectory(found[0], (found[1] - now) * NANOSECOND)

    def _at(self, now: int) -> tuple[Trajectory, int] | None:
        return next((plan for plan in reversed(self._plans) if plan[1] <= now), None)

    def clock_was_set(self, step: int | None) -> None:
        """Let all begin `step` later, as the node's clock was set; None: forget them."""
        plans = () if step is None else self._plans
        self._plans = tuple((trajectory, start + (step or 0)) for trajectory, start in plans)

    def next_start(self, now: int) -> int | None:
        """Instant at which the newest plan begins; None where that is not after `now`."""
        start = self._plans[-1][1] if self._plans else now
        return start if start > now else None


def deviation(state: Array, reference: Array, angles: NDArray[np.bool_]) -> Array:
    """Difference of two states (nx,), `angles` (nx,) by less than half a turn."""
    away = state - reference
    away[angles] = np.angle(np.exp(1j * away[angles]))
    return np.asarray(away)


def predicted_start(
    plan: TimedTrajectory | None,
    state: Array,
    measured: float,
    start: float,
    angles: NDArray[np.bool_],
    tracked: Array,
    free: Callable[[Array, float], Array],
    carried: Callable[[Array, float], Array],
) -> Array:
    """
    Return the state (nx,) at the instant `start` [s] from one measured at `measured` [s].

    Where a plan is being followed - no deviation from it is beyond `tracked` (nx,) - the plant
    will be where that plan leads, plus the deviation as `carried` over the time between. Otherwise
    it moves as `free(state, duration)` says, without control. `angles` (nx,) marks the states that
    are compared the shorter way round.
    """
    wait = start - measured
    if plan is not None:
        away = deviation(state, plan.reference(measured), angles)
        if (np.abs(away) <= tracked).all():
            return np.asarray(plan.reference(start) + carried(away, wait))
    return free(state, wait)
