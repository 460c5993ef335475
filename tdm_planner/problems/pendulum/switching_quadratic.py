# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Small dense strictly convex quadratic programs, compiled: for compiled minimisers.

    min x'H x / 2 + g'x  subject to  A x >= b,  lower <= x <= upper

The dual active-set method of Goldfarb and Idnani, "A numerically stable dual method for solving
strictly convex quadratic programs" (1983): from the unconstrained minimum on, the constraint
violated most is added to the active ones, and those whose multipliers would become negative are
dropped. `solve_quadratic_program` of `direct_method.trust_region` solves the same with a library,
where Python calls.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

_TOLERANCE = 1e-11  # of a constraint, relative to its size
_DEPENDENT = 1e-14  # squared share of a constraint's gradient that the active ones leave free


@compiled
def _inverse_factor(hessian: Array, inverse: Array) -> bool:
    """Fill `inverse` with L'^-1, H = L L'; False if H is not positive definite."""
    n = hessian.shape[0]
    factor = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = hessian[i, j]
            for m in range(j):
                total -= factor[i, m] * factor[j, m]
            if i > j:
                factor[i, j] = total / factor[j, j]
            elif total > 0.0:
                factor[i, i] = math.sqrt(total)
            else:
                return False
    inverse[:, :] = 0.0
    for column in range(n):
        for i in range(column, n):
            total = 1.0 if i == column else 0.0
            for m in range(column, i):
                total -= factor[i, m] * inverse[column, m]
            inverse[column, i] = total / factor[i, i]
    return True


@compiled
def _most_violated(
    x: Array, rows: Array, least: Array, lower: Array, upper: Array, active: NDArray[np.bool_]
) -> tuple[int, float]:
    """
    Index of the constraint violated most, relative to its size, and its value; -1 if none.

    Rows come first, then lower, then upper bounds. `active` marks those that are kept already.
    """
    m, n = rows.shape
    worst, chosen, value = -_TOLERANCE, -1, 0.0
    for i in range(m):
        total, size = -least[i], 1.0 + abs(least[i])
        for j in range(n):
            total += rows[i, j] * x[j]
        if not active[i] and total < worst * size:
            worst, chosen, value = total / size, i, total
    for j in range(n):
        below, above = x[j] - lower[j], upper[j] - x[j]
        if not active[m + j] and below < worst * (1.0 + abs(lower[j])):
            worst, chosen, value = below / (1.0 + abs(lower[j])), m + j, below
        if not active[m + n + j] and above < worst * (1.0 + abs(upper[j])):
            worst, chosen, value = above / (1.0 + abs(upper[j])), m + n + j, above
    return chosen, value


@compiled
def _normal(index: int, rows: Array, normal: Array) -> None:
    """Gradient of a constraint."""
    m, n = rows.shape
    if index < m:
        normal[:] = rows[index]
    else:
        normal[:] = 0.0
        normal[(index - m) % n] = 1.0 if index < m + n else -1.0


@compiled
def _rotation(a: float, b: float) -> tuple[float, float, float]:
    """Cosine and sine of the rotation that takes (a, b) to (r, 0), and r."""
    r = math.hypot(a, b)
    if r == 0.0:
        return 1.0, 0.0, 0.0
    return a / r, b / r, r


@compiled
def _rotate_columns(basis: Array, i: int, cosine: float, sine: float) -> None:
    for m in range(basis.shape[0]):
        a, b = basis[m, i], basis[m, i + 1]
        basis[m, i], basis[m, i + 1] = cosine * a + sine * b, cosine * b - sine * a


@compiled
def _add(basis: Array, triangle: Array, projected: Array, count: int) -> None:
    """Take up the constraint whose gradient is `projected` on the basis as the active one more."""
    n = projected.size
    for i in range(n - 2, count - 1, -1):
        cosine, sine, projected[i] = _rotation(projected[i], projected[i + 1])
        _rotate_columns(basis, i, cosine, sine)
    for i in range(count + 1):
        triangle[i, count] = projected[i]


@compiled
def _drop(basis: Array, triangle: Array, chosen: Integers, u: Array, count: int, at: int) -> None:
    """Leave out the active constraint number `at`."""
    for j in range(at, count - 1):
        chosen[j], u[j] = chosen[j + 1], u[j + 1]
        for i in range(j + 2):
            triangle[i, j] = triangle[i, j + 1]
    for i in range(at, count - 1):
        cosine, sine, triangle[i, i] = _rotation(triangle[i, i], triangle[i + 1, i])
        for j in range(i + 1, count - 1):
            a, b = triangle[i, j], triangle[i + 1, j]
            triangle[i, j], triangle[i + 1, j] = cosine * a + sine * b, cosine * b - sine * a
        _rotate_columns(basis, i, cosine, sine)


@compiled
def solve_compiled(
    hessian: Array,
    gradient: Array,
    rows: Array,
    least: Array,
    lower: Array,
    upper: Array,
    x: Array,
    multipliers: Array,
) -> bool:
    """
    Fill the minimiser `x` (n,) and the rows' `multipliers` (m,), zero or greater.

    `hessian` (n, n), `gradient` (n,), `rows` A (m, n), `least` b (m,), bounds (n,). False if the
    constraints contradict one another or H is not positive definite.
    """
    m, n = rows.shape
    basis, triangle = np.empty((n, n)), np.zeros((n, n))
    if not _inverse_factor(hessian, basis):
        return False
    x[:] = 0.0
    for j in range(n):
        share = 0.0
        for i in range(n):
            share += basis[i, j] * gradient[i]
        for i in range(n):
            x[i] -= basis[i, j] * share
    active, chosen = np.zeros(m + 2 * n, np.bool_), np.zeros(n + 1, np.intp)
    u, away, normal, projected, z = (
        np.zeros(n + 1),
        np.zeros(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
    )
    count, adding, price, violation = 0, -1, 0.0, 0.0
    for _ in range(20 * (m + 2 * n) + 20):
        if adding < 0:
            adding, violation = _most_violated(x, rows, least, lower, upper, active)
            if adding < 0:
                multipliers[:] = 0.0
                for i in range(count):
                    if chosen[i] < m:
                        multipliers[chosen[i]] = u[i]
                return True
            price = 0.0
            _normal(adding, rows, normal)
        whole, free = 0.0, 0.0
        for j in range(n):
            total = 0.0
            for i in range(n):
                total += basis[i, j] * normal[i]
            projected[j] = total
            whole += total * total
            free += total * total if j >= count else 0.0
        if not whole < np.inf:
            return False
        # How the active constraints' multipliers fall as the new one's grows.
        for i in range(count - 1, -1, -1):
            total = projected[i]
            for j in range(i + 1, count):
                total -= triangle[i, j] * away[j]
            away[i] = total / triangle[i, i]
        length, leaving = np.inf, -1
        for i in range(count):
            if away[i] > 0.0 and u[i] < length * away[i]:
                length, leaving = u[i] / away[i], i
        independent = free > _DEPENDENT * whole
        full = -violation / free if independent else np.inf
        if not min(length, full) < np.inf:
            return False
        length = min(length, full)
        if independent:
            for i in range(n):
                z[i] = 0.0
                for j in range(count, n):
                    z[i] += basis[i, j] * projected[j]
                x[i] += length * z[i]
            violation += length * free
        for i in range(count):
            u[i] -= length * away[i]
        price += length
        if length == full:
            _add(basis, triangle, projected, count)
            chosen[count], u[count], active[adding] = adding, price, True
            count, adding = count + 1, -1
        else:
            active[chosen[leaving]] = False
            _drop(basis, triangle, chosen, u, count, leaving)
            count -= 1
    return False
