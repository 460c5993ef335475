# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The search for formations' plans, whatever form their motions have.

Local minima from several first guesses by the shared minimiser, cheapest first; plans of them with
check and cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
import math
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import Budget, Point
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.exceptions import DeadlineExceeded, Infeasible, VerificationFailed
from tdm_planner.problems.formation.program import FormationProgram
from tdm_planner.problems.formation.task import FormationTask
from tdm_planner.problems.formation.verification import assessed, keeps_reserve
from tdm_planner.problems.formation.warm_start import rest_of
from tdm_planner.problems.problem import Search
from tdm_planner.problems.solution import Solution
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]
C = TypeVar('C')
P = TypeVar('P', bound=FormationProgram)

NEARLY_FEASIBLE = 2.5  # times the violation allowed, up to which a plan may survive the check
_SEARCH_SHARE = 0.75  # of the deadline, after which no other guess is tried once there is a plan
_CHECK_TIME, _CHECK_SHARE = 5e-3, 0.45  # s a robot, but no more than this share of the deadline
_MORE_MARGIN = 0.04  # of the separation, that is kept more where plans came too near


@dataclass(frozen=True)
class Candidate(Generic[P]):
    """A point of a program, a local minimum where the search for one has `converged`."""

    program: P
    point: Point
    converged: bool = True

    @property
    def cost(self) -> float:
        """Return the performance index."""
        return self.point.cost * self.program.scale


class FormationSearch(Search[C]):
    """
    What the searches for a plan of `task` share.

    They make candidates in `rounds`, one after the other until there is a plan: first from what is
    left of the `previous` plan, then from `starts` first guesses. `penalty_weights` (4,) are k1 to
    k4 of (29), `tolerance` eps of (10). `closest` is the point of the least violation seen, for
    the reason of a failure.
    """

    def __init__(
        self,
        task: FormationTask,
        rng: np.random.Generator,
        budget: Budget,
        *,
        starts: int,
        penalty_weights: Array,
        tolerance: float,
        previous: Solution | None,
    ) -> None:
        super().__init__(budget)
        self.task, self.starts, self.rng = task, starts, rng
        self.tried = 0
        self.closest: Candidate[Any] | None = None
        self.rest = {} if previous is None else rest_of(task, previous)
        self.kept: dict[str, Trajectory] = {}  # motions of robots that go on as before
        self.rounds: list[Callable[[], Iterable[C]]] = []
        self._required = task
        self._penalty_weights, self._tolerance = penalty_weights, tolerance
        # The violation, relative to a limit, whose square is worth that penalty.
        self.feasible = math.sqrt(tolerance / penalty_weights.max())

    def candidates(self) -> Iterable[C]:
        """Minima of one round, cheapest first."""
        self.kept = {}
        return self.rounds[0]()

    def widen(self) -> bool:
        """Go on with the next round, keeping more distance where plans failed the check."""
        if self.rejected and not self.rest:
            self.task = self.farther(self.task)
        self.rounds.pop(0)
        return bool(self.rounds)

    @staticmethod
    def farther(task: FormationTask) -> FormationTask:
        """Return the manoeuvre with more distance to be kept."""
        return replace(task, margin=task.margin + _MORE_MARGIN * task.separation)

    def minimised(
        self, program: P, guess: Array, options: TrustRegionOptions
    ) -> Candidate[P] | None:
        """Minimise from a guess Xi; None where that leads to nothing feasible."""
        if not program.free.size:
            return Candidate(program, program.evaluate(np.zeros(0)))
        before = program.evaluations
        # What is left when the search must end is for the check.
        until = self.budget.leaving(_CHECK_TIME * self._required.n, _CHECK_SHARE)
        minimum = minimise(program, guess, options, until)
        self.tried += 1
        self.budget.evaluations += program.evaluations - before
        candidate = Candidate(program, minimum.point, minimum.converged)
        violation = minimum.point.violation
        if self.closest is None or violation < self.closest.point.violation:
            self.closest = candidate
        # Constants so extreme that a motion has no numbers leave its margins without meaning.
        finite = math.isfinite(minimum.point.cost)
        return candidate if finite and violation <= NEARLY_FEASIBLE * self.feasible else None

    def minima(
        self, program: P, guesses: Iterable[Array], options: TrustRegionOptions, worse: float
    ) -> list[Candidate[P]]:
        """
        Feasible local minima from guesses Xi, cheapest first.

        A start that is nearly feasible at `worse` times the best cost so far is aborted. Ends
        early when the time is spent, but not before one minimum is found or time is up, and with
        one at which the robots do not hinder one another: none is cheaper.
        """
        found: list[Candidate[P]] = []
        for k, guess in enumerate(guesses):
            if found:
                best = min(each.point.cost for each in found)
                options = options._replace(cutoff=worse * best)
            candidate = self.minimised(program, guess, options)
            alone = False
            if candidate is not None:
                found.append(candidate)
                hindered = program.crowded(candidate.point) or self.rejected
                alone = candidate.converged and not hindered
            late = self.budget.elapsed > _SEARCH_SHARE * self.budget.seconds
            if self.budget.spent or alone or (found and (late or k + 1 >= self.starts)):
                break
        return sorted(found, key=lambda each: each.cost)

    def assessed(self, motions: Mapping[str, Trajectory], parameters: Array) -> Solution:
        """Return the motions with their check and cost, those that were kept among them."""
        return assessed(
            self._required,
            {**motions, **self.kept},
            self._penalty_weights,
            self._tolerance,
            parameters,
        )

    def satisfied_with(self, plan: Solution) -> bool:
        """Whether the distance kept for the tracking is left, by half at least."""
        return keeps_reserve(self._required, plan.verification)

    def failure(self) -> Infeasible:
        """Return what was found and why it does not do, or how near the search came."""
        if self.rejected:
            return VerificationFailed(f'no plan survived the check: {self.rejected}')
        closest = self.closest
        binding = '' if closest is None else closest.program.binding(closest.point)
        if self.budget.spent:
            return DeadlineExceeded(
                f'no plan within {self.budget.seconds:g} s from {self.tried} starts; nearest to '
                f'one, {binding} was violated'
            )
        return Infeasible(f'no plan from {self.tried} starts: {binding} is violated at best')
