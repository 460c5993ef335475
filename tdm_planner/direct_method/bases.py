# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Functions on the unit interval: polynomials from boundary conditions, outputs, the speed factor.

In section 3 of Yakimenko (2006), (2)-(4) give the quintic with x, x', x'' at both ends; every
further derivative that is prescribed or varied at an end raises the order by one. Here any set of
derivatives at either end works. System (4) is badly conditioned in raw tau, so it is solved on the
unit interval, in exact rational arithmetic, once for every set of conditions; the polynomial is
kept as its Taylor expansions about both ends, evaluated about the nearer one, so that the boundary
conditions hold to the last bits whatever the span and the order.

The basis of an output is what its boundary conditions determine, and well scaled free shapes.

With the speed factor lambda = dtau/dt of the virtual arc tau, d/dt = lambda d/dtau, so that

    x. = lambda x',   x.. = lambda^2 x'' + lambda lambda' x',   and so on to any order.

Yakimenko (2006) has only the first terms ((20)-(22) leave out lambda'). The maps are linear in
the derivatives of x and triangular, which is what makes the way back exact; they accept whatever
can be multiplied and added: numbers, arrays, symbols. Bernstein polynomials are positive wherever
their coefficients are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial
import math
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike
from scipy.fft import dct
from scipy.interpolate import BPoly
from tdm_planner.arrays import Array
from tdm_planner.direct_method.formulation import Shapes
from tdm_planner.exceptions import InvalidProblem

Orders = tuple[int, ...]
Sampled = Callable[[ArrayLike, int], Array]  # of s (...) and the derivative's order, (..., m)

_DEPENDENT = 1e-9  # share of a shape, or of a condition, that the others leave of it


@dataclass(frozen=True, eq=False)
class PolynomialBasis:
    """
    Shapes of the polynomials that given end derivatives determine, on the unit interval.

    `start` and `end` list the orders of the derivatives given at s = 0 and at s = 1. The shapes
    are in that order, start before end: `values(s, k)` (..., m) is the k-th derivative of each,
    shape i being the polynomial whose i-th condition is 1 and all others 0.
    """

    start: Orders
    end: Orders
    about_start: Array
    about_end: Array

    @classmethod
    @lru_cache(maxsize=256)
    def of(cls, start: Orders, end: Orders) -> PolynomialBasis:
        """Return the basis; raise InvalidProblem where these determine no polynomial."""
        size = len(start) + len(end)
        if size == 0:
            raise InvalidProblem('a polynomial needs at least one boundary condition')
        rows = [[Fraction(math.perm(p, k) * (p == k)) for p in range(size)] for k in start]
        rows += [[Fraction(math.perm(p, k)) for p in range(size)] for k in end]
        inverse = _invert(rows)
        if inverse is None:
            raise InvalidProblem(
                f'derivatives {list(start)} at the start and {list(end)} at the end do not '
                f'determine a polynomial of order {size - 1}'
            )
        shifted = [
            [
                sum((math.comb(p, j) * inverse[p][i] for p in range(size)), Fraction(0))
                for i in range(size)
            ]
            for j in range(size)
        ]
        return cls(start, end, np.array(inverse, dtype=float), np.array(shifted, dtype=float))

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative of every shape at `s` (...), (..., m)."""
        at = np.asarray(s, dtype=float)
        near_start, coefficients = at <= 0.5, _differentiated(self, derivative)
        nearer = np.where(near_start, at, at - 1.0).ravel()
        powers = polynomial.polyvander(nearer, len(coefficients) - 1)
        # Not by BLAS, whose last digits depend on the number of threads.
        table = np.einsum('sp,pm->sm', powers, coefficients).reshape(*at.shape, 2, -1)
        return np.asarray(np.where(near_start[..., None], table[..., 0, :], table[..., 1, :]))


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


@lru_cache(maxsize=256)
def _differentiated(basis: PolynomialBasis, derivative: int) -> Array:
    """Return both expansions' coefficients of a derivative, side by side, (powers, 2 m)."""
    both = np.concatenate([basis.about_start, basis.about_end], axis=1)
    return np.asarray(polynomial.polyder(both, derivative))


@dataclass(frozen=True, eq=False)
class OutputBasis:
    """
    A family of reference functions on the unit interval, split by what determines them.

    x(s) = given(s) @ b + varied(s) @ a, where b holds the derivatives of orders `start` at s = 0,
    then those of orders `end` at s = 1, and a (`size`,) is free: whatever a is, the conditions
    hold. The free shapes are orthonormal in the mean of f g + f'' g''.
    """

    start: Orders
    end: Orders
    size: int
    given: Sampled
    varied: Sampled


@lru_cache(maxsize=64)
def basis_of(shapes: Shapes | None, start: Orders, end: Orders, free: int) -> OutputBasis:
    """
    Return the basis of an output whose derivatives of these orders are given.

    Raise InvalidProblem if the conditions contradict each other, or leave no function.
    """
    family: Sampled = partial(bernstein_basis, len(start) + len(end) + free - 1)
    if shapes is not None:
        family = partial(_on_a_line, shapes)
    elif not free:
        PolynomialBasis.of(start, end)  # says what is missing
    given, varied = _split(family, start, end)
    if shapes is None:
        with suppress(InvalidProblem):  # of the least order, where there is one
            given = PolynomialBasis.of(start, end).values
    matrix = orthonormal(varied, len(start) + len(end), (0, 2))
    return OutputBasis(
        start, end, len(matrix), given, lambda s, k: np.asarray(varied(s, k) @ matrix)
    )


def orthonormal(varied: Sampled, conditions: int, derivatives: Orders) -> Array:
    """
    Return the matrix that makes shapes orthonormal in the mean of these derivatives' products.

    They are polynomials of an order up to their number plus that of `conditions`, or alike. Raise
    InvalidProblem if they depend on one another.
    """
    count = conditions + varied(0.0, 0).size
    points, weights = np.polynomial.legendre.leggauss(max(64, count + 8))
    root = np.sqrt(weights / 2.0)[:, None]
    at = (points + 1.0) / 2.0
    sampled = np.concatenate([root * varied(at, k) for k in derivatives])
    sizes = np.linalg.norm(sampled, axis=0)
    _, triangle = np.linalg.qr(sampled / sizes)
    if np.abs(np.diag(triangle)).min(initial=1.0) < 1e-3 * _DEPENDENT:
        raise InvalidProblem('some shapes are sums of others: take fewer, or others')
    return np.asarray(np.linalg.inv(triangle) / sizes[:, None])


def _on_a_line(shapes: Shapes, s: ArrayLike, derivative: int) -> Array:
    """Return functions (1) of Yakimenko (2006): linear interpolation, and shapes Phi besides."""
    return np.concatenate([bernstein_basis(1, s, derivative), shapes.values(s, derivative)], -1)


def _split(family: Sampled, start: Orders, end: Orders) -> tuple[Sampled, Sampled]:
    """
    Return a family of functions split by what determines their coefficients.

    Derivatives that are given at the ends fix some combinations, the others are varied.
    """
    asked = [(0.0, order) for order in start] + [(1.0, order) for order in end]
    rows = np.array([family(*one) for one in asked]).reshape(len(asked), family(0.0, 0).size)
    sizes = np.abs(rows).max(axis=1, initial=0.0)
    sizes[sizes == 0.0] = 1.0
    rows /= sizes[:, None]
    by_given = np.linalg.pinv(rows, rcond=_DEPENDENT)
    if np.abs(rows @ by_given - np.eye(sizes.size)).max(initial=0.0) > _DEPENDENT:
        raise InvalidProblem(
            f'{rows.shape[1]} functions cannot meet derivatives {list(start)} at the start and '
            f'{list(end)} at the end; take more (free or shapes), or others'
        )
    _, singular, directions = np.linalg.svd(rows)  # null_space of no rows: from SciPy 1.12 on
    rank = int((singular > _DEPENDENT * singular.max(initial=0.0)).sum())
    free = directions[rank:].T
    return (
        lambda s, k: np.asarray(family(s, k) @ (by_given / sizes)),
        lambda s, k: np.asarray(family(s, k) @ free),
    )


def chebyshev_nodes(count: int) -> Array:
    """Return `count` Chebyshev-Lobatto nodes on the unit interval, at least 3."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1)))


def quadrature_weights(nodes: Array) -> Array:
    """
    Return the weights (K,) that integrate functions given at Chebyshev-Lobatto `nodes` (K,).

    They are those of Clenshaw and Curtis, exact for polynomials up to order K - 1.
    """
    count = nodes.size
    k = np.arange(count)
    moments = np.where(k % 2 == 0, 1.0 / (1.0 - np.where(k % 2 == 0, k, 0) ** 2.0), 0.0)
    weights = np.asarray(dct(moments, type=1)) / (count - 1)
    weights[[0, -1]] *= 0.5
    return weights


def bernstein_basis(degree: int, s: ArrayLike, derivative: int = 0) -> Array:
    """
    Return the `derivative`-th derivative of B_0..B_degree at s (...), (..., degree + 1).

    That of order -1 is the integral from 0 to s.
    """
    return np.asarray(_bernstein(degree, derivative)(np.array(s, dtype=float)))


@lru_cache(maxsize=64)
def _bernstein(degree: int, derivative: int) -> BPoly:
    return BPoly(np.eye(degree + 1)[:, None], [0.0, 1.0]).derivative(derivative)


def time_derivatives(jet: Sequence[Any], factor: Sequence[Any]) -> list[Any]:
    """
    Return x, x., x.., ... from x, x', x'', ... and lambda, lambda', ...

    As many as `jet` has; one element less of `factor` is needed.
    """
    found, left = [jet[0]], list(jet)
    while len(left) > 1:
        left = _product(factor, left[1:])
        found.append(left[0])
    return found


def arc_derivatives(wanted: Sequence[Any], factor: Sequence[Any]) -> list[Any]:
    """Return x, x', x'', ... from x, x., x.., ... and lambda, lambda', ...: the way back."""
    found = [wanted[0]]
    for order in range(1, len(wanted)):
        lower = time_derivatives([*found, 0.0 * found[0]], factor[:order])[-1]
        found.append((wanted[order] - lower) / factor[0] ** order)
    return found


def reciprocal(jet: Sequence[Any]) -> list[Any]:
    """Return 1/f and its derivatives from f and its derivatives: lambda from dt/dtau."""
    found = [1.0 / jet[0]]
    for order in range(1, len(jet)):
        terms: Any = sum(
            math.comb(order, j) * jet[j] * found[order - j] for j in range(1, order + 1)
        )
        found.append(-terms / jet[0])
    return found


def _product(first: Sequence[Any], second: Sequence[Any]) -> list[Any]:
    """Return the derivatives of a product, as many as the shorter factor has (Leibniz' rule)."""
    count = min(len(first), len(second))
    return [
        sum(math.comb(n, j) * first[j] * second[n - j] for j in range(n + 1)) for n in range(count)
    ]
