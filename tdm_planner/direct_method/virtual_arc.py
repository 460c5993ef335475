# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The virtual arc: nodes on it, the speed factor as a Bernstein polynomial, derivatives along it.

With the speed factor lambda = dtau/dt, d/dt = lambda d/dtau, so that

    x. = lambda x',   x.. = lambda^2 x'' + lambda lambda' x',   and so on to any order.

Yakimenko (2006) has only the first terms ((20)-(22) leave out lambda'). The maps are linear in
the derivatives of x and triangular, which is what makes the way back exact; they accept whatever
can be multiplied and added: numbers, arrays, symbols. Bernstein polynomials are positive wherever
their coefficients are.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dct
from scipy.interpolate import BPoly

Array = NDArray[np.float64]


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
