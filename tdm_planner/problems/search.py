# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The direct method's outer loop (section 3 of Yakimenko 2006), the same for every problem.

First guesses are minimised to candidates; the most promising are refined with more nodes and
written out as trajectories until one passes the check; where none does, it begins anew, wider.
What a problem brings is how its candidates come about and how they are refined.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from typing import Generic, TypeVar

from tdm_planner.direct_method.nonlinear_program import Budget
from tdm_planner.exceptions import Infeasible
from tdm_planner.problems.solution import Solution

C = TypeVar('C')


class Search(ABC, Generic[C]):
    """
    One search for a plan; `run` carries it out.

    `budget` is the time it may take; `rejected` why the last plan failed its check, empty if none
    did.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self.rejected = ''

    @abstractmethod
    def candidates(self) -> Iterable[C]:
        """Minimise from a round of first guesses; feasible results, the most promising first."""

    @abstractmethod
    def plans(self, candidate: C) -> Iterator[Solution]:
        """
        Yield plans of a candidate: each, better refined, is asked for if the last one failed.

        Once the budget is spent it should end, except that the first candidate deserves its check.
        """

    @abstractmethod
    def failure(self) -> Infeasible:
        """Return the reason why there is no plan."""

    def promises_more(self, candidate: C, than: C) -> bool:
        """Whether a candidate is worth a check though another has given a plan."""
        return True

    def satisfied_with(self, plan: Solution) -> bool:
        """Whether a verified plan ends the search at once."""
        return True

    def widen(self) -> bool:
        """Prepare another round after one without a plan; False ends the search."""
        return True

    def run(self) -> Solution:
        """
        Return the first plan to satisfy, else the cheapest of the round that passes the check.

        Raises
        ------
        Infeasible
            If there is none; its subclass says why.

        """
        while True:
            best: tuple[C, Solution] | None = None
            for candidate in self.candidates():
                if best is None or self.promises_more(candidate, best[0]):
                    plan = self._verified(candidate)
                    if plan is not None and self.satisfied_with(plan):
                        return plan
                    if plan is not None and (best is None or plan.cost < best[1].cost):
                        best = candidate, plan
                if self.budget.spent:
                    break
            if best is not None:
                return best[1]
            if self.budget.spent or not self.widen():
                raise self.failure()

    def _verified(self, candidate: C) -> Solution | None:
        for plan in self.plans(candidate):
            if plan.verification.ok:
                return plan
            self.rejected = plan.verification.reasons[0]
        return None
