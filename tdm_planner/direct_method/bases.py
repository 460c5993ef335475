# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Functions on the unit interval: polynomials from boundary conditions, and Taranenko's shapes.

Taranenko's shapes Phi of section 2 of Yakimenko (2006) vanish at both ends. Section 3 has
polynomials: (2)-(4) give the quintic with x, x', x'' at both ends; every further derivative that
is prescribed or varied at an end raises the order by one. Here any set of derivatives at either
end works. System (4) is badly conditioned in raw tau, so it is solved on the unit interval for
derivatives scaled by the span, in exact rational arithmetic, once for every set of conditions; and
the polynomial is kept as its Taylor expansions about both ends, evaluated about the nearer one,
so that the boundary conditions hold to the last bits whatever the span and the order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tdm_planner.direct_method.checks import check_orders, shown, whole
from tdm_planner.exceptions import InvalidProblem

Array = NDArray[np.float64]

_MOST = 100  # terms, and exponents: more cannot be told apart in floating point
# Multiplications of one matrix product: few enough for the result not to depend on the threads.
_BLOCK = 65536


class Shapes(ABC):
    """
    Functions phi_k(s) on the unit interval with phi_k(0) = phi_k(1) = 0; Phi = sum A_k phi_k.

    Families can be combined: `SineSeries(3) + symmetric_powers(2)`.
    """

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the number of shapes m."""

    @abstractmethod
    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative of every shape at s (...), (..., m)."""

    def __add__(self, other: Shapes) -> Shapes:
        """Return the shapes of both families."""
        if not isinstance(other, Shapes):
            return NotImplemented
        return CombinedShapes((self, other))


@dataclass(frozen=True)
class CombinedShapes(Shapes):
    """The shapes of several families, one after the other."""

    families: tuple[Shapes, ...]

    @property
    def size(self) -> int:
        """Return the number of shapes."""
        return sum(family.size for family in self.families)

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m)."""
        return np.concatenate([f.values(s, derivative) for f in self.families], axis=-1)


@dataclass(frozen=True)
class SineSeries(Shapes):
    """sin(k pi s), k = 1..`terms`. All even derivatives vanish at the ends."""

    terms: int

    def __post_init__(self) -> None:
        """Check the number of terms."""
        whole(self.terms, 'the number of terms of a sine series', 1, _MOST)

    @property
    def size(self) -> int:
        """Return the number of shapes."""
        return self.terms

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m)."""
        k = np.arange(1, self.terms + 1)
        at = np.asarray(s, dtype=float)[..., None]
        # From the nearer end, so that the values at both ends are exact.
        beyond = at > 0.5
        angle = k * np.pi * np.where(beyond, 1.0 - at, at)
        parity = np.where(beyond, (-1.0) ** k, 1.0)
        wave = np.cos(angle) if derivative % 2 else np.where(beyond, -np.sin(angle), np.sin(angle))
        sign = -1.0 if derivative % 4 in (2, 3) else 1.0
        return np.asarray(sign * (k * np.pi) ** derivative * parity * wave)


@dataclass(frozen=True)
class PowerProducts(Shapes):
    """
    s^m1 (s - 1)^m2 for every pair (m1, m2) of `exponents`, both at least 1.

    In the paper's argument these are (tau - tau_0)^m1 (tau - tau_f)^m2; their coefficients here
    are the paper's times (tau_f - tau_0)^(m1 + m2), in the unit of x.
    """

    exponents: Any  # kept as a tuple of pairs

    def __post_init__(self) -> None:
        """Check the exponents."""
        try:
            pairs = tuple((first, second) for first, second in self.exponents)
        except (TypeError, ValueError):
            pairs = ()
        if not pairs:
            raise InvalidProblem(
                f'exponents = {shown(self.exponents)} must be pairs, such as [(1, 2), (2, 2)]'
            )
        for pair in pairs:
            for exponent in pair:  # at least 1, for the product to vanish at both ends
                whole(exponent, f'an exponent of {shown(pair)}', 1, _MOST)
        object.__setattr__(self, 'exponents', pairs)

    @property
    def size(self) -> int:
        """Return the number of shapes."""
        return len(self.exponents)

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the derivatives of all shapes, (..., m), by Leibniz' rule."""
        at = np.asarray(s, dtype=float)
        shapes = [product_derivative(at, a, b, derivative) for a, b in self.exponents]
        return np.stack(shapes, axis=-1)


def product_derivative(s: Array, first: int, second: int, derivative: int) -> Array:
    """Return the `derivative`-th derivative of s^first (s - 1)^second, exponents >= 0."""
    total = np.zeros_like(s)
    for j in range(max(0, derivative - second), min(derivative, first) + 1):
        factor = math.comb(derivative, j) * math.perm(first, j) * math.perm(second, derivative - j)
        total = total + factor * s ** (first - j) * (s - 1.0) ** (second - derivative + j)
    return total


def symmetric_powers(terms: int) -> PowerProducts:
    """Return s^k (s - 1)^k, k = 1..`terms`: symmetric about the middle of the arc."""
    count = whole(terms, 'the number of terms of a series of powers', 1, _MOST)
    return PowerProducts(tuple((k, k) for k in range(1, count + 1)))


@dataclass(frozen=True, eq=False)
class PolynomialBasis:
    """
    Shapes of the polynomials that given end derivatives determine, on the unit interval.

    `start` and `end` list the orders of the derivatives given at s = 0 and at s = 1. The shapes
    are in that order, start before end: `values(s, k)` (..., m) is the k-th derivative of each,
    shape i being the polynomial whose i-th condition is 1 and all others 0.
    """

    start: tuple[int, ...]
    end: tuple[int, ...]
    about_start: Array
    about_end: Array

    @classmethod
    def of(cls, start: tuple[int, ...], end: tuple[int, ...]) -> PolynomialBasis:
        """
        Return the basis for these derivatives (cached).

        Raises
        ------
        InvalidProblem
            If an order is repeated or negative, or the conditions do not determine a polynomial.

        """
        return _basis(check_orders('start', start), check_orders('end', end))

    @property
    def order(self) -> int:
        """Order of the polynomials: one less than the number of conditions."""
        return len(self.start) + len(self.end) - 1

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative of every shape at `s` (...), (..., m)."""
        at = np.asarray(s, dtype=float)
        near_start = at <= 0.5
        coefficients = _differentiated(self, derivative)
        powers = np.empty((coefficients.shape[0], at.size))
        powers[:1] = 1.0
        powers[1:] = np.where(near_start, at, at - 1.0).ravel()
        np.multiply.accumulate(powers, axis=0, out=powers)
        count = coefficients.shape[1] // 2
        block = max(1, _BLOCK // coefficients.size) if coefficients.size else at.size + 1
        starts = range(block, at.size, block)
        rows = [part.T @ coefficients for part in np.split(powers, starts, axis=1)]
        table = rows[0] if len(rows) == 1 else np.concatenate([np.zeros((0, 2 * count)), *rows])
        both = table.reshape(*at.shape, 2 * count)
        return np.asarray(np.where(near_start[..., None], both[..., :count], both[..., count:]))


@lru_cache(maxsize=256)
def _basis(start: tuple[int, ...], end: tuple[int, ...]) -> PolynomialBasis:
    size = len(start) + len(end)
    if size == 0:
        raise InvalidProblem('a polynomial needs at least one boundary condition')
    rows = [[_derivative_of_power(p, k, 0) for p in range(size)] for k in start]
    rows += [[_derivative_of_power(p, k, 1) for p in range(size)] for k in end]
    inverse = _invert(rows)
    if inverse is None:
        raise InvalidProblem(
            f'derivatives {list(start)} at the start and {list(end)} at the end do not determine '
            f'a polynomial of order {size - 1}'
        )
    shifted = [
        [
            sum((math.comb(p, j) * inverse[p][i] for p in range(size)), Fraction(0))
            for i in range(size)
        ]
        for j in range(size)
    ]
    return PolynomialBasis(start, end, _to_array(inverse), _to_array(shifted))


def _derivative_of_power(power: int, order: int, s: int) -> Fraction:
    """Return d^order/ds^order of s^power, at s = 0 or 1."""
    if order > power or (s == 0 and order < power):
        return Fraction(0)
    return Fraction(math.perm(power, order))


def _invert(rows: list[list[Fraction]]) -> list[list[Fraction]] | None:
    """Gauss-Jordan elimination in exact arithmetic; None if the matrix is singular."""
    n = len(rows)
    work = [row + [Fraction(int(i == j)) for j in range(n)] for i, row in enumerate(rows)]
    for column in range(n):
        pivot = next((r for r in range(column, n) if work[r][column] != 0), None)
        if pivot is None:
            return None
        work[column], work[pivot] = work[pivot], work[column]
        scale = work[column][column]
        work[column] = [value / scale for value in work[column]]
        for r in range(n):
            factor = work[r][column]
            if r != column and factor != 0:
                work[r] = [a - factor * b for a, b in zip(work[r], work[column], strict=True)]
    return [row[n:] for row in work]


def _to_array(matrix: list[list[Fraction]]) -> Array:
    array = np.array([[float(value) for value in row] for row in matrix])
    array.flags.writeable = False
    return array


@lru_cache(maxsize=256)
def _differentiated(basis: PolynomialBasis, derivative: int) -> Array:
    """Return both expansions' coefficients of a derivative, side by side, (powers, 2 m)."""
    both = np.concatenate([basis.about_start, basis.about_end], axis=1)[derivative:]
    factors = [math.perm(power + derivative, derivative) for power in range(len(both))]
    found: Array = np.array(factors, dtype=float)[:, None] * both
    found.flags.writeable = False
    return found
