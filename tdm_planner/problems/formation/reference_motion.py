# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Reference functions of the robots: position and attitude as polynomials of the virtual arc.

On the unit arc s in [0, 1] a robot's coordinates are X(s) = X_b(s) + sum_k q_k phi_k(s): X_b takes
the boundary conditions that are given, phi_k span the polynomials that change none of them, which
are those of the end derivatives that are varied. They are orthonormal in the inner product of
their second derivatives, for the sake of conditioning. A polynomial is kept as all of its end
derivatives, those at s = 0 first, so that `PolynomialBasis` evaluates it.

Time runs along the arc as dt/ds = mu(s) = sum_k b_k B_k(s) > 0, a polynomial in Bernstein's form:
with the virtual arc's length tau_f the speed factor of section 2 is lambda = tau_f / mu. Degree 0
is tau = t, and b_0 the time the manoeuvre takes. A velocity v and an acceleration a at an end
become X_s = mu v and X_ss = mu^2 a + mu_s v. With N = X_ss mu - X_s mu_s the exact inverse, in
place of (21) and (27), which lose the speed factor's slope, is

    X' = X_s / mu,   X'' = N / mu^3.
"""

from __future__ import annotations

from functools import lru_cache
import math
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.direct_method.bases import (
    bernstein_basis,
    chebyshev_nodes,
    orthonormal,
    PolynomialBasis,
    quadrature_weights,
)
from tdm_planner.plants.compilation import compiled, inlined

_ACTIVE = 0.35, 0.5, 1.0  # margins of thrust, torque and walls that make a row
_NEWTON_STEPS, _MOST_STEPS = 12, 80  # of the inversion of time


@inlined
def acceleration(mu: Any, mu_s: Any, first: Any, second: Any) -> Any:
    """Return X'' from derivatives by s."""
    return (second * mu - first * mu_s) / (mu * mu**2)


@compiled
def powers_at(coefficients: Array, u: float) -> tuple[float, float, float]:
    """Value at u of the polynomial with these coefficients of its powers, and two derivatives."""
    value, first, second = 0.0, 0.0, 0.0
    for k in range(coefficients.size - 1, -1, -1):
        second = second * u + first
        first = first * u + value
        value = value * u + coefficients[k]
    return value, first, 2.0 * second


@compiled
def arc_at(times: Array, duration: float, since: float) -> float:
    """
    Return s in [0, 1] at which a time that rises with s, of powers `times`, is `since` [s].

    By Newton's method in a bracket.
    """
    s = min(max(since / duration, 0.0), 1.0)
    low, high = 0.0, 1.0
    if times.size == 2 or s == 0.0 or s == 1.0:
        return s
    for step in range(_MOST_STEPS):
        time, mu, _ = powers_at(times, s)
        error = time - since
        if abs(error) <= 1e-15 * duration:
            break
        if error < 0.0:
            low = s
        else:
            high = s
        last, s = s, s - error / mu
        if not low <= s <= high or (step >= _NEWTON_STEPS and step % 3 == 2):
            s = 0.5 * (low + high)
        if s == last:
            break
    return s


@compiled
def arcs_at(times: Array, duration: float, since: Array) -> Array:
    """Arcs s (K,) at which the time is `since` (K,) s, see `arc_at`."""
    found = np.empty(since.size)
    for k in range(since.size):
        found[k] = arc_at(times, duration, since[k])
    return found


class MotionForm(NamedTuple):
    """
    The reference functions' form.

    Orders of the polynomials of x and y, and of the attitude's; degree of mu; whether the
    accelerations at the ends are varied, not given; number of nodes, None: as `order` needs.
    """

    order: int = 7
    yaw_order: int = 5
    degree: int = 0
    vary_ends: bool = True
    nodes: int | None = None


@lru_cache(maxsize=32)
def end_derivatives(order: int, vary_curvature: bool) -> tuple[PolynomialBasis, Array]:
    """
    Return the polynomials of odd order >= 5 by as many derivatives at either end, and the phi_k.

    Those are given by their end derivatives (order + 1, nf); `vary_curvature`: X_ss is varied at
    both ends.
    """
    given = (0, 1) if vary_curvature else (0, 1, 2)
    every = tuple(range((order + 1) // 2))
    basis = PolynomialBasis.of(every, every)
    varied = [k not in given for k in (*basis.start, *basis.end)]
    free = np.zeros((order + 1, sum(varied)))
    shapes = orthonormal(
        lambda s, derivative: basis.values(s, derivative)[..., varied], 2 * len(given), (2,)
    )
    free[varied] = shapes * np.sign(np.diag(shapes))  # whichever signs LAPACK chose
    free.flags.writeable = False
    return basis, free


class Grid(NamedTuple):
    """
    What depends on the form of the references alone, at K nodes and W arcs for walls.

    Axes are x, y and yaw, all with m end derivatives: as many as the highest order has. `shapes`
    (3, m, P) are end derivatives by the varied parameters, but for those by b; the start's
    accelerations are `given` (3,): 1, or 0 where varied. `rates` (2, K, q + 1) are mu and mu_s by
    b, `slope` (q + 1,) is mu_s at the start; `paths` (3, 2, K, m) the first two derivatives and
    `places` (W, m) by the end derivatives. `taylor` (2, m, m): expansions of x or y about s = 0
    and 1; `passing` (q + 1, q + 2): powers of s in the time at s, by b. `weights` (K,) of the
    quadrature. `active` (2 K + 4 W,): below them margins make a row, those of thrust and torque at
    the nodes, and of the walls.
    """

    weights: Array
    shapes: Array
    given: Array
    rates: Array
    slope: Array
    paths: Array
    places: Array
    taylor: Array
    passing: Array
    active: Array


@lru_cache(maxsize=32)
def grid_of(form: MotionForm) -> Grid:
    """Tabulate what depends on the form alone."""
    s = chebyshev_nodes(form.nodes or max(21, 5 * form.order - 14))
    basis, free = end_derivatives(form.order, form.vary_ends)
    axes = ((basis, free), (basis, free), end_derivatives(form.yaw_order, False))
    nb, count, arcs = form.degree + 1, form.order + 1, 2 * form.order - 1
    most = 1 + max(form.order, form.yaw_order)
    shapes = np.zeros((3, most, nb + sum(varied.shape[1] for _, varied in axes)))
    paths, first = np.zeros((3, 2, s.size, most)), nb
    for axis, (of, varied) in enumerate(axes):
        size, last = len(varied), first + varied.shape[1]
        shapes[axis, :size, first:last], first = varied, last
        paths[axis, :, :, :size] = [of.values(s, d) for d in (1, 2)]
    places, taylor = np.zeros((arcs, most)), np.zeros((2, most, most))
    places[:, :count] = basis.values(np.arange(1, arcs + 1) / (arcs + 1))
    for k in range(count):
        taylor[:, k, :count] = basis.values([0.0, 1.0], k) / math.factorial(k)
    passing = np.zeros((nb, nb + 1))
    for d in range(nb):
        passing[:, d + 1] = bernstein_basis(form.degree, 0.0, d) / math.factorial(d + 1)
    return Grid(
        weights=quadrature_weights(s),
        shapes=shapes,
        given=np.array([1.0 - form.vary_ends, 1.0 - form.vary_ends, 1.0]),
        rates=np.stack([bernstein_basis(form.degree, s, d) for d in range(2)]),
        slope=bernstein_basis(form.degree, 0.0, 1),
        paths=paths,
        places=places,
        taylor=taylor,
        passing=passing,
        active=np.repeat(_ACTIVE, [s.size, s.size, 4 * arcs]),
    )
