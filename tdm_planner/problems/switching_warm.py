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
Method `switching` from an earlier plan: its arcs, shifted in time, are tried before all else.

The rest of a plan that is under way nearly solves the problem from where the plant is: steered
upright it is polished at once, and the first plan that passes the check is taken.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.plants.pendulum_steering import ARRIVED
from tdm_planner.problems.search import Plan
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_method import SwitchingMethod
from tdm_planner.problems.switching_search import (
    Candidate,
    distinct,
    FINE_STEPS,
    steered,
    trajectory,
    without_short_arcs,
)
from tdm_planner.problems.switching_seeds import Arcs, warm_starts

_CHANGES = (0.0, 0.03, 0.1)  # of the logarithms of the arcs' durations, tried one after the other
_STEPS = (FINE_STEPS // 2, FINE_STEPS)  # RK4 steps an arc of the polish; more if the check fails
_STEERED = 0.6  # share of the deadline after which no more is tried with the earlier plan
_TRIED = 3  # arrivals that are polished


class WarmSwitchingMethod(SwitchingMethod):
    """The search from the arcs of the `previous` plan; if they lead to none, a new one."""

    def __init__(
        self,
        task: SwingUpTask,
        budget: Budget,
        rng: np.random.Generator,
        arcs: int,
        tolerance: float,
        previous: Arcs,
    ) -> None:
        super().__init__(task, budget, rng, arcs, tolerance)
        self._previous: Arcs | None = previous

    def candidates(self) -> Iterable[Candidate]:
        """Arrivals of the earlier arcs, a little changed if need be; then those of the search."""
        if self._previous is None:
            return super().candidates()
        return self._warm(self._previous)

    def _warm(self, previous: Arcs) -> Iterator[Candidate]:
        tried: list[Candidate] = []
        for change in _CHANGES:
            if len(tried) >= _TRIED or self.budget.elapsed > _STEERED * self.budget.seconds:
                return
            batch = warm_starts(self._task, self._rng, previous, self._arcs, change)
            if batch is None:
                return
            until = _STEERED * self.budget.seconds
            found = steered(self._task, batch, self._steps, self.budget, until)
            self._remember_closest(batch)
            self._starts += batch.arcs.size
            self._arrived += int((batch.costs < ARRIVED).sum())
            for candidate in distinct(found)[: _TRIED - len(tried)]:
                tried.append(candidate)
                yield candidate

    def plans(self, candidate: Candidate) -> Iterator[Plan]:
        """Yield the motion under the polished arcs, first with half the steps."""
        if self._previous is None:
            yield from super().plans(candidate)
            return
        for steps in _STEPS:
            if self.budget.spent:
                return
            fine, violation = self._finely(candidate, steps)
            if violation > 1e-6:
                return
            fine = without_short_arcs(self._task, fine)
            yield self._task.plan(trajectory(self._task, fine), fine.durations, violation)
            candidate = fine

    def widen(self) -> bool:
        """Give the earlier plan up."""
        if self._previous is None:
            return super().widen()
        self._previous = None
        return True
