# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The minimiser of (10): sequential quadratic programming in a trust region, elastic constraints.

Every step solves one small quadratic program that is feasible by construction: each group of
constraints has one slack t_k >= 0, charged rho_k t_k, and the step is bounded by the trust region.
The merit function is J + sum_k rho_k violation_k (the exact l-infinity penalty), see Nocedal and
Wright, *Numerical Optimization*, chapters 17 and 18, and Fletcher's second-order correction
against the Maratos effect.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Generic, NamedTuple, TypeVar

import daqp
import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.nonlinear_program import (
    Budget,
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)

P = TypeVar('P', bound=NonlinearProgram)

_INFINITE = 1e30
SLACK_CURVATURE = 1e-4
_LARGEST_RADIUS = 4.0  # of the trust region, in units of the scaled varied parameters
PRESSURE = 5.0  # factor by which violations are charged more
_SLACK_LEFT = 0.9  # share of the slack that must be left at most for that to be worth it


class TrustRegionOptions(NamedTuple):
    """
    How the minimiser goes about it.

    `penalties` rho_k, one for each group of constraints, raised up to about `largest_penalty`
    where they do not make the search feasible; `radius` the first trust region, in units of the
    scaled varied parameters; `cost_tolerance` the predicted decrease, relative to J, below which
    the search ends once every group's violation is within its `feasibility`; `corrections` the
    most second-order corrections a step; `cutoff` the cost above which a nearly feasible search is
    aborted, as another one is already better. With `steering`, penalties are raised as soon as
    that takes a step nearer to the linearised constraints, not only where the search stalls: for
    ends that are hard to reach.
    """

    penalties: tuple[float, ...] = (1.0,)
    largest_penalty: float = 200.0
    radius: float = 0.3
    iterations: int = 40
    cost_tolerance: float = 1e-3
    feasibility: tuple[float, ...] = (2e-3,)
    corrections: int = 0
    steering: bool = False
    cutoff: float = np.inf


@dataclass(frozen=True)
class Minimum(Generic[P]):
    """Where the search ended: the best point, and whether it converged to a feasible one."""

    program: P
    point: Point
    iterations: int
    converged: bool


@dataclass(frozen=True)
class _Step:
    """
    Solution of the elastic quadratic program: step, decrease it predicts, multipliers.

    `slacks` are what every group of linearised constraints is still violated by.
    """

    change: Array
    predicted: float
    slacks: Array
    multipliers: Multipliers


def minimise(
    program: P,
    xi: Array,
    options: TrustRegionOptions | None = None,
    budget: Budget | None = None,
) -> Minimum[P]:
    """
    Search from `xi` (n,) for a local minimum of the program; see `TrustRegionOptions`.

    The `budget` counts the evaluations; once it is spent the best point so far is returned, not
    converged. So is the only point where nothing can be varied.
    """
    given = options or TrustRegionOptions(), budget or Budget(math.inf)
    search = _Search(program, np.asarray(xi, dtype=float), *given)
    while search.continues and not search.budget.spent:
        search.advance()
    return Minimum(program, search.point, search.iterations, search.converged)


class _Search:
    """The iterate, and what is known about it."""

    def __init__(
        self, program: NonlinearProgram, xi: Array, options: TrustRegionOptions, budget: Budget
    ) -> None:
        self.program = program
        self.options = options
        self.budget = budget
        self.penalties = np.array(options.penalties, dtype=float)
        self.feasibility = np.array(options.feasibility, dtype=float)
        self.radius = options.radius
        self.iterations = 0
        self.stalled = 0
        self.converged = False
        self.multipliers: Multipliers | None = None
        self.point = self.evaluate(xi)
        # From where nothing can be computed there is no way on.
        self.failed = not np.isfinite([self.point.cost, *self.point.violations]).all()
        self.at: Linearisation | None = None

    @property
    def continues(self) -> bool:
        left = self.iterations < self.options.iterations and self.point.xi.size > 0
        return left and not (self.converged or self.failed)

    def evaluate(self, xi: Array) -> Point:
        """Return the nearest point within the bounds; numpy.clip takes five times as long."""
        self.budget.evaluations += 1
        bounds = self.program.lower, self.program.upper
        return self.program.evaluate(np.minimum(np.maximum(xi, bounds[0]), bounds[1]))

    def merit(self, point: Point) -> float:
        return point.cost + float(self.penalties @ point.violations)

    @property
    def feasible(self) -> bool:
        return bool((self.point.violations <= self.feasibility).all())

    def advance(self) -> None:
        """One quadratic program, and the step if it is good."""
        self.iterations += 1
        if self.at is None:
            self.at = self.program.linearise(self.point, self.multipliers)
            self.budget.evaluations += self.at.evaluations
            slopes = self.at.gradient, self.at.equality_jacobian
            # As of a root at zero: no program leads on from here.
            self.failed = not all(np.isfinite(part).all() for part in slopes)
            if self.failed or self.budget.spent:
                return
        step = _quadratic_step(self, self.at)
        if step is not None and self.options.steering:
            step = self._steered(step, self.at)
        if step is None:
            self._shrink(self.radius)
            return
        if step.predicted < self.options.cost_tolerance * max(abs(self.point.cost), 1e-6):
            self._finish_or_press()
            if not self.continues or self.stalled == 0:
                return
        else:
            self.stalled = 0
        self._try(step)

    def _steered(self, step: _Step, at: Linearisation) -> _Step:
        """
        Charge violations more while the step then comes nearer to the constraints.

        The penalty update of Byrd, Nocedal and Waltz (2008), in its simplest form.
        """
        while True:
            before, missed = self.penalties, step.slacks > self.feasibility
            if not missed.any() or before[missed].max() >= self.options.largest_penalty:
                break
            self.penalties = np.where(missed, PRESSURE * before, before)
            harder = _quadratic_step(self, at)
            if harder is None or harder.slacks.sum() > _SLACK_LEFT * step.slacks.sum():
                self.penalties = before
                break
            step = harder
        return step

    def _finish_or_press(self) -> None:
        """Nothing more to gain: done if feasible, else charge violations more."""
        if self.feasible:
            self.converged = True
            return
        self.stalled += 1
        if self.stalled >= 2 and self.penalties.max() < self.options.largest_penalty:
            self.penalties[self.point.violations > self.feasibility] *= PRESSURE
            self.radius = max(self.radius, 0.5 * self.options.radius)
            self.stalled = 0

    def _try(self, step: _Step) -> None:
        point = self.point
        assert self.at is not None
        trial = self.evaluate(point.xi + step.change)
        if self.options.corrections and step.slacks.max(initial=0.0) < 1e-4:
            trial = _correct(self, self.at, step, trial)
        gained = self.merit(point) - self.merit(trial)
        length = float(np.abs(step.change).max())
        ratio = gained / max(step.predicted, 1e-12) if np.isfinite(gained) else -np.inf
        negligible = step.predicted < 1e-7 and gained > -1e-9
        if not (ratio > 0.05 or negligible):
            self._shrink(length)
            return
        self.point, self.multipliers, self.at = trial, step.multipliers, None
        if ratio > 0.75 and length > 0.9 * self.radius:
            self.radius = min(2.0 * self.radius, _LARGEST_RADIUS)
        elif ratio < 0.25:
            self.radius *= 0.5
        if self.iterations >= 5 and trial.cost > self.options.cutoff:
            self.failed = trial.violation < 1e-3

    def _shrink(self, length: float) -> None:
        self.radius = 0.35 * min(self.radius, length)
        if self.radius >= 1e-6:
            return
        if not self.feasible and self.penalties.max() < self.options.largest_penalty:
            self.penalties[self.point.violations > self.feasibility] *= PRESSURE
            self.radius = 0.5 * self.options.radius
            self.at = None
        else:
            self.converged = self.feasible
            self.failed = not self.feasible


def _quadratic_step(search: _Search, at: Linearisation) -> _Step | None:
    """Solve the elastic quadratic program in (d, e, t): step, absolute terms, slacks."""
    n, na, ng = at.gradient.size, at.terms.size, search.penalties.size
    ne = at.equalities.size
    size = n + na + ng
    hessian = np.zeros((size, size))
    hessian[:n, :n] = at.hessian
    diagonal = slice(n * (size + 1), None, size + 1)
    hessian.ravel()[diagonal] = SLACK_CURVATURE
    gradient = np.concatenate([at.gradient, at.term_weights, search.penalties])
    rows, least = _elastic_rows(at, ng)
    lower, upper = np.zeros(size), np.full(size, 1e12)
    lower[:n] = np.maximum(-search.radius, search.program.lower - search.point.xi)
    upper[:n] = np.minimum(search.radius, search.program.upper - search.point.xi)
    solution = solve_quadratic_program(hessian, gradient, rows, least, lower, upper)
    if solution is None:
        return None
    (found, dual), first = solution, n + na
    change, slacks = found[:n], np.maximum(found[first:], 0.0)
    terms = np.abs(at.terms + at.terms_jacobian @ change) if na else at.terms
    model = (
        at.gradient @ change
        + 0.5 * change @ at.hessian @ change
        + at.term_weights @ terms
        + search.penalties @ slacks
    )
    now = at.term_weights @ np.abs(at.terms) + search.penalties @ search.point.violations
    both, last = 2 * ne, 2 * ne + at.inequalities.size
    multipliers = Multipliers(dual[ne:both] - dual[:ne], dual[both:last], at.tags)
    return _Step(change, float(now - model), slacks, multipliers)


def _elastic_rows(at: Linearisation, ng: int) -> tuple[Array, Array]:
    """Rows A z >= b: equalities from both sides, inequalities, absolute terms, in that order."""
    parts = at.gradient, at.equalities, at.inequalities, at.terms
    n, ne, ni, na = (part.size for part in parts)
    both, last = 2 * ne, 2 * ne + ni
    rows, least = np.zeros((last + 2 * na, n + na + ng)), np.empty(last + 2 * na)
    rows[:ne, :n], rows[ne:both, :n] = at.equality_jacobian, -at.equality_jacobian
    rows[:both, n + na] = 1.0
    rows[both:last, :n] = at.inequality_jacobian
    rows[np.arange(both, last), n + na + at.inequality_groups] = 1.0
    least[:last] = np.concatenate([-at.equalities, at.equalities, -at.inequalities])
    if na:
        rows[last:, :n] = np.concatenate([-at.terms_jacobian, at.terms_jacobian])
        term = np.arange(2 * na)
        rows[last + term, n + term % na] = 1.0
        least[last:] = np.concatenate([at.terms, -at.terms])
    return rows, least


def _correct(search: _Search, at: Linearisation, step: _Step, trial: Point) -> Point:
    """Second-order correction: pull the trial back to the constraints along their gradients."""
    program = search.program
    active = step.multipliers.inequalities > 1e-9
    inverse: Array | None = None
    free = np.zeros(0, dtype=bool)
    for _ in range(search.options.corrections):
        if not 1e-9 < trial.violation < 2.0:
            break
        beyond = np.minimum(trial.margins[at.tags[active]], 0.0)
        if inverse is None:
            free = (trial.xi > program.lower + 1e-9) & (trial.xi < program.upper - 1e-9)
            jacobian = np.concatenate([at.equality_jacobian, at.inequality_jacobian[active]])
            inverse = np.linalg.pinv(jacobian[:, free], rcond=1e-4)
        back = np.zeros_like(trial.xi)
        back[free] = inverse @ np.append(trial.equalities, beyond)
        if np.abs(back).max(initial=0.0) > 2.0 * search.radius:
            break
        better = search.evaluate(trial.xi - back)
        if not better.violation < 0.8 * trial.violation:
            break
        trial = better
    return trial


def solve_quadratic_program(
    hessian: Array, gradient: Array, rows: Array, least: Array, lower: Array, upper: Array
) -> tuple[Array, Array] | None:
    """
    Minimise d'H d / 2 + g'd subject to A d >= b, lower <= d <= upper, H positive definite.

    Return d and the multipliers (>= 0) of the rows A d >= b, (m,), by the library DAQP; None if
    the program is infeasible or ill conditioned.

    Shapes: `hessian` (n, n), `gradient` (n,), `rows` A (m, n), `least` b (m,), finite bounds (n,).
    """
    n, m = gradient.size, least.size
    above, below = np.append(upper, np.full(m, _INFINITE)), np.append(lower, least)
    step, _, flag, info = daqp.solve(
        np.ascontiguousarray(hessian),
        np.ascontiguousarray(gradient),
        np.ascontiguousarray(rows),
        above,
        below,
        np.zeros(n + m, dtype=np.int32),
    )
    if flag < 1 or not np.isfinite(step).all():
        return None
    multipliers = np.abs(np.asarray(info['lam'])[n:])
    return np.asarray(step), multipliers
