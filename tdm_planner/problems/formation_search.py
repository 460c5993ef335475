# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The search for formations' plans: several first guesses, the shared minimiser, best first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tdm_planner.direct_method.nonlinear_program import Budget, Point
from tdm_planner.direct_method.trust_region import minimise, TrustRegionOptions
from tdm_planner.problems.formation_plan import initial_misalignment
from tdm_planner.problems.formation_program import FormationProgram
from tdm_planner.problems.formation_seeds import BowSeeds
from tdm_planner.problems.formation_task import FormationTask
from tdm_planner.problems.reference_motion import Motion, ReferenceMotion

Array = NDArray[np.float64]

_FEASIBLE = 5e-3  # violation, relative to the limit, up to which a plan may survive the check
_TURNING_SHARE = 0.95  # of the thruster's rate, at which it turns before a manoeuvre
_ALIGNED = 0.02  # [rad] less than this needs no turning
_MANY = 12  # robots from which on violations are charged more
_RADIUS, _REFINING_RADIUS = 0.15, 0.05
_SEARCH_SHARE = 0.75  # of the deadline: the rest is for the check


@dataclass(frozen=True)
class Form:
    """The reference functions and their grid: parameters of `ReferenceMotion` and the program."""

    order: int = 7
    yaw_order: int = 5
    speed_factor_order: int = 0
    vary_ends: bool = True
    nodes: int | None = None

    def model(self, task: FormationTask) -> ReferenceMotion:
        """Reference functions of a manoeuvre."""
        return ReferenceMotion(
            task, self.order, self.yaw_order, self.speed_factor_order, self.vary_ends
        )


@dataclass(frozen=True)
class Candidate:
    """A local minimum: the program it solves and the point found."""

    program: FormationProgram
    point: Point

    @property
    def cost(self) -> float:
        """Performance index, gas by quadrature."""
        return self.point.cost * self.program.scale

    @property
    def motion(self) -> Motion:
        """The reference motions."""
        return self.program.motion(self.point.xi)


class FormationSearch:
    """Local minima of one manoeuvre from several first guesses.

    `closest` is the point of the least violation seen, for the reason of a failure.
    """

    def __init__(
        self, task: FormationTask, form: Form, rng: np.random.Generator, budget: Budget
    ) -> None:
        self.task, self.form, self.budget = task, form, budget
        self.model = form.model(task)
        self.program = FormationProgram(self.model, form.nodes)
        self.seeds = BowSeeds(self.model, rng)
        self._guesses = iter(self.seeds)
        self.closest: Candidate | None = None
        self.tried = 0

    def guess_from(self, motion: Array) -> Array:
        """First guess Xi nearest to the varied parameters (n, P)."""
        return self.program.reduce(motion)

    def minima(self, starts: int, first: Array | None = None) -> list[Candidate]:
        """Feasible local minima from `starts` guesses, cheapest first; `first` Xi is tried first.

        Ends early when the time is spent, but not before one minimum is found or time is up.
        """
        found: list[Candidate] = []
        for guess in self._starting_points(starts, first):
            candidate, converged = self._minimise(self.program, guess, _RADIUS)
            self.tried += 1
            if converged:
                found.append(candidate)
            late = self.budget.elapsed > _SEARCH_SHARE * self.budget.seconds
            if self.budget.spent or (late and found):
                break
        return sorted(found, key=lambda candidate: candidate.cost)

    def _starting_points(self, starts: int, first: Array | None) -> Iterator[Array]:
        if first is not None:
            yield first
        for _ in range(starts):
            yield self.program.reduce(next(self._guesses))

    def _minimise(
        self, program: FormationProgram, guess: Array, radius: float
    ) -> tuple[Candidate, bool]:
        penalty = 3.0 if program.model.task.n >= _MANY else 1.0
        options = TrustRegionOptions(
            penalties=(penalty, 0.5)[: program.groups],
            feasibility=(2e-3, 2e-2)[: program.groups],
            radius=radius,
            iterations=60,
        )
        before = program.evaluations
        minimum = minimise(program, guess, options, self.budget)
        self.budget.evaluations += program.evaluations - before
        candidate = Candidate(program, minimum.point)
        violation = float(minimum.point.violations[0])
        if self.closest is None or violation < self.closest.point.violations[0]:
            self.closest = candidate
        return candidate, violation <= _FEASIBLE

    def turned(self, candidate: Candidate) -> Candidate | None:
        """Let thrusters that point elsewhere turn first: the same motions after coasting.

        The time a thruster needs depends on the motion and the motion on the time: a few rounds.
        None if that is not feasible.
        """
        for spare in (1.0, 1.03, 1.1):
            model = candidate.program.model
            angle = initial_misalignment(model, candidate.motion)
            needed = angle / (_TURNING_SHARE * self.task.thruster_rate)
            needed = np.where(angle > _ALIGNED, needed + 0.01 * candidate.motion.durations, 0.0)
            kept = model.task.coast
            if ((needed <= kept) & (kept <= 1.2 * needed + 0.05)).all():
                return candidate
            task = self.task.with_coast(spare * needed)
            program = FormationProgram(self.form.model(task), self.form.nodes)
            again = program.reduce(candidate.program.full(candidate.point.xi))
            candidate, converged = self._minimise(program, again, _REFINING_RADIUS)
            if not converged:
                return None
        return candidate

    def refined(self, candidate: Candidate) -> Candidate | None:
        """Minimise again with the thruster's rate limited in the program; None if infeasible."""
        model = candidate.program.model
        program = FormationProgram(model, self.form.nodes, limit_thruster_rate=True)
        better, converged = self._minimise(program, candidate.point.xi, _REFINING_RADIUS)
        return better if converged else None

    def wider(self, rng: np.random.Generator) -> FormationSearch:
        """Return a search that keeps more distance, after plans failed the check."""
        margin = self.task.margin + 0.04 * self.task.separation
        other = FormationSearch(replace(self.task, margin=margin), self.form, rng, self.budget)
        other.closest = self.closest
        return other
