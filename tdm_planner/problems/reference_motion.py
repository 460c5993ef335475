# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Reference functions of the robots: position and attitude as polynomials of the virtual arc.

On the unit arc s in [0, 1] a robot's coordinates are X(s) = X_b(s) + sum_k q_k phi_k(s): X_b takes
the boundary conditions that are given, phi_k span the polynomials that change none of them, which
are those of the end derivatives that are varied. They are orthonormal in the inner product of
their second derivatives, for the sake of conditioning.

Time runs along the arc as dt/ds = mu(s) = sum_k b_k B_k(s) > 0, a polynomial in Bernstein's form:
with the virtual arc's length tau_f the speed factor of section 2 is lambda = tau_f / mu. Degree 0
is tau = t, and b_0 the time the manoeuvre takes. A velocity v and an acceleration a at an end
become X_s = mu v and X_ss = mu^2 a + mu_s v. With N = X_ss mu - X_s mu_s the exact inverse is

    X' = X_s / mu,   X'' = N / mu^3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation_task import FormationTask

Array = NDArray[np.float64]


def powers(s: Array, derivative: int, order: int) -> Array:
    """Return derivatives of the monomials 1, s, ..., s^order at s (...), as (..., order + 1)."""
    s = np.asarray(s, dtype=float)
    values = np.zeros((*s.shape, order + 1))
    for p in range(derivative, order + 1):
        values[..., p] = math.perm(p, derivative) * s ** (p - derivative)
    return values


class HermiteBasis(NamedTuple):
    """Monomial coefficients of the functions of one coordinate.

    `given` (order + 1, 6): the functions that take X, X_s, X_ss at s = 0 and at s = 1;
    `free` (order + 1, nf): the phi_k.
    """

    given: Array
    free: Array


@lru_cache(maxsize=32)
def hermite_basis(order: int, vary_curvature: bool) -> HermiteBasis:
    """Make the functions of odd order >= 5; `vary_curvature`: X_ss is varied at both ends."""
    half = (order + 1) // 2
    rows = [powers(np.array(end), d, order) for end in (0.0, 1.0) for d in range(half)]
    functions = np.linalg.inv(np.array(rows))
    given = functions[:, [0, 1, 2, half, half + 1, half + 2]]
    lowest = 2 if vary_curvature else 3
    free = functions[:, [*range(lowest, half), *range(half + lowest, 2 * half)]]
    nodes, weights = np.polynomial.legendre.leggauss(order + 1)
    curvature = powers((nodes + 1) / 2, 2, order) @ free
    if free.shape[1]:
        gram = curvature.T @ (weights[:, None] / 2 * curvature)
        free = free @ np.linalg.inv(np.linalg.cholesky(gram)).T
    given.flags.writeable = free.flags.writeable = False
    return HermiteBasis(given, free)


@lru_cache(maxsize=8)
def _bernstein(degree: int) -> Array:
    """Monomial coefficients of the Bernstein polynomials, (degree + 1, degree + 1) by column."""
    matrix = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        for p in range(k, degree + 1):
            matrix[p, k] = math.comb(degree, p) * math.comb(p, k) * (-1) ** (p - k)
    matrix.flags.writeable = False
    return matrix


@dataclass(frozen=True, eq=False)
class Motion:
    """The motions of all robots at one set of varied parameters.

    `rates` (n, q + 1): the coefficients b of mu [s]; `position` (n, 2, order + 1) and `yaw`
    (n, yaw order + 1): monomial coefficients; `position_slope` (n, 2, q + 1, order + 1) and
    `yaw_slope` (n, q + 1, yaw order + 1): their derivatives with respect to b.
    """

    rates: Array
    position: Array
    yaw: Array
    position_slope: Array
    yaw_slope: Array

    @property
    def durations(self) -> Array:
        """Time each manoeuvre takes, without coasting (n,) s: the integral of mu."""
        return np.asarray(self.rates.mean(axis=1))


class ReferenceMotion:
    """Map from a robot's varied parameters (P,) to its motion, for all n robots at once.

    The varied parameters of one robot are, scaled: b (q + 1), q of x (nf), of y (nf), of yaw (ny).
    `order` of the polynomials of x and y, `yaw_order` of the attitude's, `speed_factor_order` the
    degree of mu, `vary_ends`: the accelerations at the ends are varied, not given.
    """

    def __init__(
        self,
        task: FormationTask,
        order: int = 7,
        yaw_order: int = 5,
        speed_factor_order: int = 0,
        vary_ends: bool = True,
    ) -> None:
        self.task = task
        self.order, self.yaw_order, self.degree = order, yaw_order, speed_factor_order
        self.vary_ends = vary_ends
        self.basis = hermite_basis(order, vary_ends)
        self.yaw_basis = hermite_basis(yaw_order, False)
        self.bernstein = _bernstein(self.degree)
        self.nb, self.nf = self.degree + 1, self.basis.free.shape[1]
        self.ny = self.yaw_basis.free.shape[1]
        self.size = self.nb + 2 * self.nf + self.ny
        self.time_scale, self.length_scale = _scales(task)
        self.yaw_scale = 10.0
        self.moving_start = bool(
            task.velocity.any() or (task.acceleration.any() and not vary_ends)
        )

    def unpack(self, z: Array) -> Motion:
        """Motions at the scaled varied parameters z (n, P)."""
        task, n = self.task, self.task.n
        b = z[:, : self.nb] * self.time_scale
        begin, end = self.nb, self.nb + 2 * self.nf
        shape = z[:, begin:end].reshape(n, 2, self.nf)
        given = self.basis.given
        position = (
            task.departure[..., None] * given[:, 0]
            + task.goal[..., None] * given[:, 3]
            + (shape * self.length_scale) @ self.basis.free.T
        )
        slope = np.zeros((n, 2, self.nb, self.order + 1))
        if self.moving_start:
            acceleration = np.zeros_like(task.velocity) if self.vary_ends else task.acceleration
            added, slope = self._departing(b, task.velocity, acceleration, given)
            position = position + added
        given = self.yaw_basis.given
        yaw = task.departure_yaw[:, None] * given[:, 0] + task.goal_yaw[:, None] * given[:, 3]
        added, yaw_slope = self._departing(
            b, task.yaw_rate[:, None], task.yaw_acceleration[:, None], given, curved=True
        )
        yaw = yaw + added[:, 0]
        if self.ny:
            free = z[:, end:] * self.yaw_scale
            yaw = yaw + free @ self.yaw_basis.free.T
        return Motion(b, position, yaw, slope, yaw_slope[:, 0])

    def _departing(
        self, b: Array, v: Array, a: Array, given: Array, curved: bool | None = None
    ) -> tuple[Array, Array]:
        """Contribution of the initial rates v and accelerations a (n, d), and d/db."""
        q, b0 = self.degree, b[:, 0, None, None]
        slope = np.zeros((*v.shape, self.nb, given.shape[0]))
        value = b0 * v[..., None] * given[:, 1]
        slope[:, :, 0] = v[..., None] * given[:, 1]
        if not self.vary_ends if curved is None else curved:
            value = value + b0**2 * a[..., None] * given[:, 2]
            slope[:, :, 0] += 2 * b0 * a[..., None] * given[:, 2]
            if q:
                value = value + q * (b[:, 1, None, None] - b0) * v[..., None] * given[:, 2]
                slope[:, :, 0] -= q * v[..., None] * given[:, 2]
                slope[:, :, 1] += q * v[..., None] * given[:, 2]
        return value, slope

    def speed_basis(self, s: Array, derivative: int) -> Array:
        """Bernstein polynomials or a derivative of them at s (...); -1 is the integral from 0."""
        if derivative >= 0:
            return powers(s, derivative, self.degree) @ self.bernstein
        exponents = np.arange(1, self.nb + 1)
        return (np.asarray(s)[..., None] ** exponents / exponents) @ self.bernstein

    def arc_at(self, motion: Motion, t: Array) -> Array:
        """Arc s in [0, 1] of every robot at the common instants t (K,) s, (n, K)."""
        since = t - self.task.coast[:, None]
        duration = motion.durations[:, None]
        s = np.clip(since / duration, 0.0, 1.0)
        if self.degree == 0:
            return s
        target = np.clip(since, 0.0, duration)
        for _ in range(60):
            mu = np.einsum('nkb,nb->nk', self.speed_basis(s, 0), motion.rates)
            time = np.einsum('nkb,nb->nk', self.speed_basis(s, -1), motion.rates)
            step = np.clip((target - time) / mu, -0.2, 0.2)
            s = np.clip(s + step, 0.0, 1.0)
            if np.abs(step).max(initial=0.0) < 1e-10:
                break
        return s

    def position_at(self, motion: Motion, t: Array) -> Array:
        """Positions at the common instants t (K,), coasting before and parked after, (n, 2, K)."""
        s = self.arc_at(motion, t)[:, None, :]
        value = np.broadcast_to(motion.position[:, :, -1:], (*motion.position.shape[:2], t.size))
        for k in range(self.order - 1, -1, -1):
            value = value * s + motion.position[:, :, k, None]
        if self.task.coast.any():
            early = np.minimum(t - self.task.coast[:, None], 0.0)
            value = value + self.task.velocity[..., None] * early[:, None, :]
        return value

    def points(
        self, motion: Motion, robots: NDArray[np.intp], s: Array, at_fixed_time: bool
    ) -> tuple[Array, Array]:
        """Positions (r, 2) of `robots` (r,) at the arcs s (r,), and d/dz (r, 2, P).

        The derivative is taken at a fixed instant of time, or at a fixed arc.
        """
        monomials = s[:, None] ** np.arange(self.order + 1)
        coefficients = motion.position[robots]
        value = (coefficients @ monomials[..., None])[..., 0]
        jacobian = np.zeros((s.size, 2, self.size))
        shapes = monomials @ self.basis.free * self.length_scale
        for axis in range(2):
            first = self.nb + axis * self.nf
            last = first + self.nf
            jacobian[:, axis, first:last] = shapes
        if self.moving_start:
            slope = np.einsum('rdbm,rm->rdb', motion.position_slope[robots], monomials)
            jacobian[:, :, : self.nb] = slope * self.time_scale
        if at_fixed_time:
            lower = np.arange(1, self.order + 1) * monomials[:, :-1]
            speed = (coefficients[..., 1:] @ lower[..., None])[..., 0]
            mu = np.einsum('rb,rb->r', self.speed_basis(s, 0), motion.rates[robots])
            under_way = (s > 0.0) & (s < 1.0)
            shift = self.speed_basis(s, -1) * (under_way * self.time_scale / mu)[:, None]
            jacobian[:, :, : self.nb] -= speed[..., None] * shift[:, None]
        return value, jacobian

    def pack(self, b: Array, shape: Array) -> Array:
        """Scaled varied parameters of b (n, q + 1) s and q (n, 2, nf) m, yaw at rest: (n, P)."""
        n = len(b)
        yaw = np.zeros((n, self.ny))
        scaled = (shape / self.length_scale).reshape(n, -1)
        return np.concatenate([b / self.time_scale, scaled, yaw], axis=1)


def _scales(task: FormationTask) -> tuple[float, float]:
    """Time [s] and length [m] by which the varied parameters are scaled."""
    way = np.linalg.norm(task.goal - task.departure, axis=1)
    speed = np.linalg.norm(task.velocity, axis=1)
    longest = max(float(way.max()), task.separation)
    time = max(2.4 * math.sqrt(longest / task.thrust), float(speed.max()) / task.thrust)
    return time, 10.0 * longest
