# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The nonlinear program (10): the smallest J over the varied parameters with penalty <= eps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
import time
from typing import Any

import numpy as np
from tdm_planner.arrays import Array, Integers

_GRACE = 0.04  # s that a replay may take past the deadline


class Budget:
    """
    The time a search may take, and a count of what it did: of its parts as well.

    With `evaluations` the count is the clock, and so many of them are the `seconds`: then what is
    found does not depend on the machine, nor on what else it does.
    """

    def __init__(self, seconds: float, evaluations: int | None = None) -> None:
        self.started = time.perf_counter()
        self.seconds = seconds
        self._count = [0]
        self._counted_from = 0
        self._worth = None if evaluations is None else seconds / evaluations

    @property
    def evaluations(self) -> int:
        """How often the dynamics were computed along a candidate."""
        return self._count[0]

    @evaluations.setter
    def evaluations(self, count: int) -> None:
        self._count[0] = count

    @property
    def age(self) -> float:
        """Time since the search began, by the clock on the wall [s]."""
        return time.perf_counter() - self.started

    @property
    def elapsed(self) -> float:
        """Time since the search began [s], or what the evaluations since then are worth."""
        if self._worth is None:
            return self.age
        return (self._count[0] - self._counted_from) * self._worth

    @property
    def remaining(self) -> float:
        """Time left [s], negative when it is spent."""
        return self.seconds - self.elapsed

    @property
    def spent(self) -> bool:
        """Whether the deadline has passed."""
        return self.remaining <= 0

    def past(self, share: float) -> bool:
        """Whether more than that share of the time is over."""
        return self.elapsed > share * self.seconds

    def part(self, seconds: float) -> Budget:
        """Return a budget of so many seconds [s] from now, whose count is that of the whole."""
        part = Budget(seconds)
        part._count, part._counted_from = self._count, self._count[0]
        part._worth = self._worth
        return part

    def with_grace(self) -> Budget:
        """Return what remains, a little if nothing does: for the replay of what was found."""
        return self.part(max(self.remaining, _GRACE))

    def charged(self, seconds: float) -> float:
        """Return what such work [s] counts: nothing where evaluations are counted."""
        return seconds if self._worth is None else 0.0

    def leaving(self, seconds: float, share: float) -> Budget:
        """Return what remains but for `seconds` [s], at most that `share` of the whole."""
        return self.part(self.remaining - min(seconds, share * self.seconds))


@dataclass(frozen=True)
class Point:
    """
    The program's values at one Xi.

    `cost` is J; `violations` (n_groups,) the largest violation of a constraint in every group of
    constraints, 0 where all are kept (equalities count by their absolute value); `cache` whatever
    the program wants to keep for `linearise`. The second-order correction alone asks for the
    residuals of all `equalities` (ne,) and for all `margins` (m,).
    """

    xi: Array
    cost: float
    violations: Array
    cache: Any = None
    equalities: Array = field(default_factory=lambda: np.zeros(0))
    margins: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def violation(self) -> float:
        """Return the largest violation of all."""
        return float(self.violations.max(initial=0.0))


@dataclass(frozen=True)
class Linearisation:
    """
    First derivatives, and a positive definite Hessian of the Lagrangian, at one Xi.

    The cost is smooth(Xi) + sum_k weight_k |term_k(Xi)|; `gradient` (n,) is that of the smooth
    part, `terms` (na,) and `terms_jacobian` (na, n) give the absolute part. `equalities` (ne,)
    belong to group 0; `inequalities` (ni,) >= 0 to the groups in `inequality_groups` (ni,).
    Rows far from active may be omitted. `tags` (ni,) are the places of the inequalities given
    among the point's margins; they are handed back with the multipliers. It took `evaluations`
    beside that of the point.
    """

    gradient: Array
    hessian: Array
    equalities: Array
    equality_jacobian: Array
    inequalities: Array
    inequality_jacobian: Array
    inequality_groups: Integers
    terms: Array = field(default_factory=lambda: np.zeros(0))
    terms_jacobian: Array = field(default_factory=lambda: np.zeros((0, 0)))
    term_weights: Array = field(default_factory=lambda: np.zeros(0))
    tags: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    evaluations: int = 0


@dataclass(frozen=True)
class Multipliers:
    """Multipliers of the rows of a linearisation; zero or greater for inequalities."""

    equalities: Array
    inequalities: Array
    tags: Integers


class NonlinearProgram(ABC):
    """
    Performance index and constraints as functions of the scaled varied parameters Xi (n,).

    `lower` and `upper` (n,) bound Xi. Scaling is the program's: a change of 1 in any component
    should matter about as much as in any other.
    """

    lower: Array
    upper: Array

    @abstractmethod
    def evaluate(self, xi: Array) -> Point:
        """Return the performance index and violations at `xi`."""

    @abstractmethod
    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Return derivatives at a point; `multipliers` are those of the last quadratic program."""
