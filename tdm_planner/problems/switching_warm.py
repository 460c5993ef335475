# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Method `switching` from an earlier plan: its arcs, shifted in time, are tried before all else.

The rest of a plan that is under way nearly solves the problem from where the plant is: steered
upright it is polished at once, and the first plan that passes the check is taken.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
import math

import numpy as np
from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.problems.base import Solution
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.problems.switching_method import SwitchingMethod
from tdm_planner.problems.switching_search import (
    Candidate,
    corrected,
    distinct,
    FEWEST_ARCS,
    FINE_STEPS,
    land,
    trajectory,
    without_short_arcs,
)
from tdm_planner.problems.switching_seeds import Arcs

_CHANGES = (0.0, 0.03, 0.1)  # of the logarithms of the arcs' durations, tried one after the other
_STEPS = (FINE_STEPS // 2, FINE_STEPS)  # RK4 steps an arc of the polish; more if the check fails
_STEERED = 0.6  # share of the deadline after which no more is tried with the earlier plan
_TRIED = 3  # arrivals that are polished
_STEERED_ARCS = 56  # the last ones, where there are more
_POLISHED, _CORRECTED = 12, 16  # most arcs whose time is minimised; varied, where there are more


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
        tried, until = 0, _STEERED * self.budget.seconds
        for change in _CHANGES:
            guesses = warm_starts(self._task, self._rng, previous, self._arcs, change)
            found = land(
                self._task, guesses, self._steps, self.budget, lambda: self.budget.elapsed > until
            )
            self._starts += len(guesses)
            self._arrived += len(found)
            for candidate in distinct(found)[: _TRIED - tried]:
                tried += 1
                yield candidate
            if tried >= _TRIED or self.budget.elapsed > until:
                return

    def plans(self, candidate: Candidate) -> Iterator[Solution]:
        """
        Yield the motion under the polished arcs, first with half the steps.

        The times of many arcs are not minimised anew: they are those of the earlier plan.
        """
        if self._previous is None:
            yield from super().plans(candidate)
            return
        task = self._task
        polished = candidate.durations.size <= _POLISHED
        if not polished:
            fixed = max(candidate.fixed, candidate.durations.size - _CORRECTED)
            candidate = replace(candidate, fixed=fixed)
        for steps in _STEPS:
            if self.budget.spent:
                return
            if polished:
                fine, violation = self._finely(candidate, task.steps(steps))
            else:
                fine, violation = corrected(task, candidate, task.steps(steps))
            if violation > 1e-6:
                return
            fine = without_short_arcs(task, fine)
            yield task.plan(trajectory(task, fine), fine.durations, violation)
            candidate = fine

    def widen(self) -> bool:
        """Give the earlier plan up."""
        if self._previous is None:
            return super().widen()
        self._previous = None
        return True


def warm_starts(
    task: SwingUpTask, rng: np.random.Generator, previous: Arcs, most: int, change: float
) -> list[Candidate]:
    """
    Return the arcs of an earlier plan, their durations changed at random.

    `change` is the standard deviation of the logarithms of the durations. An arc of no duration is
    put before or after them, or both, where a new switch may grow; there are at most `most`.
    """
    sizes, found = np.abs(previous.torques), list[Candidate]()
    held = np.clip(previous.torques, -task.torque, task.torque)
    if np.ptp(sizes) <= 1e-9 * sizes[0]:  # extreme torques, they may be others now
        held = np.copysign(task.torque, held)
    for before, after in ((0, 1), (0, 0), (1, 0), (1, 1)):
        after = max(after, FEWEST_ARCS + 1 - before - held.size)
        count = before + held.size + after
        if count > max(most, FEWEST_ARCS + 1):
            continue
        end = -math.copysign(task.torque, held[-1]) * (-1.0) ** np.arange(after)
        first = np.full(before, -math.copysign(task.torque, held[0]))
        durations = previous.durations * np.exp(change * rng.normal(size=held.size))
        found.append(
            Candidate(
                np.concatenate([np.zeros(before), durations, np.zeros(after)]),
                np.concatenate([first, held, end]),
                0,
                max(count - _STEERED_ARCS, 0),
            )
        )
    return found
