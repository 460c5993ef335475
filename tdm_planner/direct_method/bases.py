# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Functions on the unit interval: polynomials from boundary conditions, outputs, the speed factor.

In section 3 of Yakimenko (2006), (2)-(4) give the quintic with x, x', x'' at both ends; every
further derivative that is prescribed or varied at an end raises the order by one. Here any set of
derivatives at either end works. System (4) is badly conditioned in powers of raw tau, so it is
solved for Bernstein's polynomials on the unit interval, once for every set of conditions. Only
k + 1 of them have a k-th derivative at an end: values and first derivatives there hold to the last
bit, those of the orders 2 to 7 to 1e-7 at the worst, mostly to 1e-12.

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
from functools import lru_cache, partial
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dct
from scipy.special import comb
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
    coefficients: Array  # of Bernstein's polynomials (m, m), a column a shape

    @classmethod
    @lru_cache(maxsize=256)
    def of(cls, start: Orders, end: Orders) -> PolynomialBasis:
        """Return the basis; raise InvalidProblem where these determine no polynomial."""
        degree = len(start) + len(end) - 1
        if degree < 0:
            raise InvalidProblem('a polynomial needs at least one boundary condition')
        rows, sizes = _at_ends(partial(bernstein_basis, degree), start, end)
        if np.linalg.matrix_rank(rows) <= degree:
            raise InvalidProblem(
                f'derivatives {list(start)} at the start and {list(end)} at the end do not '
                f'determine a polynomial of order {degree}'
            )
        return cls(start, end, np.linalg.inv(rows) / sizes)

    def values(self, s: ArrayLike, derivative: int = 0) -> Array:
        """Return the `derivative`-th derivative of every shape at `s` (...), (..., m)."""
        return _combined(self.coefficients, s, derivative)


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
    rows, sizes = _at_ends(family, start, end)
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


def _at_ends(family: Sampled, start: Orders, end: Orders) -> tuple[Array, Array]:
    """Return the given derivatives by the coefficients, rows of size 1 (n, m); the sizes (n,)."""
    asked = [(0.0, order) for order in start] + [(1.0, order) for order in end]
    rows = np.array([family(*one) for one in asked]).reshape(len(asked), family(0.0, 0).size)
    sizes = np.abs(rows).max(axis=1, initial=0.0)
    sizes[sizes == 0.0] = 1.0
    return rows / sizes[:, None], sizes


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
    return _combined(np.eye(degree + 1), s, derivative)


def _combined(coefficients: Array, s: ArrayLike, derivative: int) -> Array:
    """Return a derivative at s (...) of B_0..B_n summed by `coefficients` (n + 1, m), (..., m)."""
    n = len(coefficients) - derivative - 1
    if derivative < 0:
        found = np.tri(n + 1, n, -1) @ coefficients / n
    else:
        found = math.perm(n + derivative, derivative) * np.diff(coefficients, derivative, axis=0)
    at, k = np.asarray(s, dtype=float)[..., None], np.arange(n + 1)
    basis = comb(n, k) * at**k * (1.0 - at) ** k[::-1]
    # Not by BLAS, whose last digits depend on the number of threads.
    return np.asarray(np.einsum('...k,km->...m', basis, found))


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
