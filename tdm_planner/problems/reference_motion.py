# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
become X_s = mu v and X_ss = mu^2 a + mu_s v. With N = X_ss mu - X_s mu_s the exact inverse is

    X' = X_s / mu,   X'' = N / mu^3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bernstein import bernstein_basis, bernstein_integral
from tdm_planner.direct_method.output_basis import OrthonormalBasis, VariedPolynomials
from tdm_planner.direct_method.polynomial import PolynomialBasis
from tdm_planner.direct_method.speed_factor import invert_time
from tdm_planner.problems.formation_task import FormationTask

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EndDerivatives:
    """
    The polynomials of one coordinate, determined by as many derivatives at either end.

    `basis` evaluates them; `free` (order + 1, nf) holds the end derivatives of the phi_k.
    """

    basis: PolynomialBasis
    free: Array

    @property
    def goal(self) -> int:
        """Where the value at s = 1 is among the end derivatives."""
        return len(self.basis.start)


@lru_cache(maxsize=32)
def end_derivatives(order: int, vary_curvature: bool) -> EndDerivatives:
    """Make the polynomials of odd order >= 5; `vary_curvature`: X_ss is varied at both ends."""
    given = (0, 1) if vary_curvature else (0, 1, 2)
    polynomials = VariedPolynomials.of(given, given, order + 1 - 2 * len(given))
    basis = polynomials.basis
    varied = [k not in given for k in (*basis.start, *basis.end)]
    free = np.zeros((order + 1, sum(varied)))
    orthonormal = OrthonormalBasis.of(polynomials, (2,)).transformation
    free[varied] = orthonormal * np.sign(np.diag(orthonormal))  # whichever signs LAPACK chose
    free.flags.writeable = False
    return EndDerivatives(basis, free)


@dataclass(frozen=True, eq=False)
class FormationMotion:
    """
    The motions of all robots at one set of varied parameters.

    `rates` (n, q + 1): the coefficients b of mu [s]; `position` (n, 2, order + 1) and `yaw`
    (n, yaw order + 1): end derivatives by s; `position_slope` (n, 2, q + 1, order + 1) and
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
    """
    Map from a robot's varied parameters (P,) to its motion, for all n robots at once.

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
        self.basis = end_derivatives(order, vary_ends)
        self.yaw_basis = end_derivatives(yaw_order, False)
        # mu and mu_s at the start, by the coefficients b.
        self.departing = [bernstein_basis(self.degree, 0.0, d) for d in range(2)]
        self.nb, self.nf = self.degree + 1, self.basis.free.shape[1]
        self.ny = self.yaw_basis.free.shape[1]
        self.size = self.nb + 2 * self.nf + self.ny
        self.time_scale, self.length_scale = _scales(task)
        self.yaw_scale = 10.0
        self.moving_start = bool(
            task.velocity.any() or (task.acceleration.any() and not vary_ends)
        )

    def with_task(self, task: FormationTask) -> ReferenceMotion:
        """Return the same reference functions for another manoeuvre."""
        return ReferenceMotion(task, self.order, self.yaw_order, self.degree, self.vary_ends)

    def fit(self, b: Array, s: Array, weights: Array, wanted: Array) -> Array:
        """
        Varied parameters (n, P) of rates b (n, q + 1) s whose motions bend most as `wanted`.

        `wanted` (n, 2, K) are the second derivatives at the arcs s (K,), with quadrature `weights`
        (K,). The yaw is at rest.
        """
        base = self.unpack(self.pack(b, np.zeros((len(b), 2, self.nf)))).position
        bend = self.values(s, 2)
        return self.pack(b, ((wanted - base @ bend.T) * weights) @ (bend @ self.basis.free))

    def raise_order(self, low: ReferenceMotion, z: Array) -> Array:
        """Varied parameters (n, P) of the same motions as `low` with z, of lower order, has."""
        motion = low.unpack(z)
        nodes, weights = np.polynomial.legendre.leggauss(self.order + 3)
        s = (nodes + 1) / 2
        raised = self.fit(motion.rates, s, weights / 2, motion.position @ low.values(s, 2).T)
        if self.ny:
            own, its = self.size - self.ny, low.size - low.ny
            raised[:, own:] = z[:, its:]
        return raised

    def unpack(self, z: Array) -> FormationMotion:
        """Motions at the scaled varied parameters z (n, P)."""
        task, n = self.task, self.task.n
        b = z[:, : self.nb] * self.time_scale
        begin, end = self.nb, self.nb + 2 * self.nf
        shape = z[:, begin:end].reshape(n, 2, self.nf)
        position = (shape * self.length_scale) @ self.basis.free.T
        position[..., 0], position[..., self.basis.goal] = task.departure, task.goal
        slope = np.zeros((n, 2, self.nb, self.order + 1))
        if self.moving_start:
            given = [task.velocity] if self.vary_ends else [task.velocity, task.acceleration]
            self._depart(b, given, position, slope)
        yaw = np.zeros((n, 1, self.yaw_order + 1))
        if self.ny:
            yaw[:, 0] = (z[:, end:] * self.yaw_scale) @ self.yaw_basis.free.T
        yaw[:, 0, 0], yaw[:, 0, self.yaw_basis.goal] = task.departure_yaw, task.goal_yaw
        yaw_slope = np.zeros((n, 1, self.nb, self.yaw_order + 1))
        given = [task.yaw_rate[:, None], task.yaw_acceleration[:, None]]
        self._depart(b, given, yaw, yaw_slope)
        return FormationMotion(b, position, yaw[:, 0], slope, yaw_slope[:, 0])

    def _depart(self, b: Array, given: list[Array], ends: Array, slope: Array) -> None:
        """
        Enter the initial velocity, and acceleration, (n, d) into end derivatives, and d/db.

        As `arc_derivatives` does; written out here for the derivative by b.
        """
        mu, by_rates = (b @ self.departing[0])[:, None], self.departing
        velocity = given[0]
        ends[..., 1] = mu * velocity
        slope[..., 1] = velocity[..., None] * by_rates[0]
        if len(given) > 1:
            acceleration = given[1]
            ends[..., 2] = mu**2 * acceleration + (b @ by_rates[1])[:, None] * velocity
            slope[..., 2] = (2 * mu * acceleration)[..., None] * by_rates[0]
            slope[..., 2] += velocity[..., None] * by_rates[1]

    def values(self, s: Array, derivative: int = 0) -> Array:
        """Polynomials of x and y by their end derivatives, at s (...), (..., order + 1)."""
        return self.basis.basis.values(s, derivative)

    def yaw_values(self, s: Array, derivative: int = 0) -> Array:
        """Polynomials of the attitude by their end derivatives, (..., yaw order + 1)."""
        return self.yaw_basis.basis.values(s, derivative)

    def speed_basis(self, s: Array, derivative: int) -> Array:
        """Bernstein polynomials or a derivative of them at s (...); -1 is the integral from 0."""
        if derivative < 0:
            return bernstein_integral(self.degree, s)
        return bernstein_basis(self.degree, s, derivative)

    def arc_at(self, motion: FormationMotion, t: Array) -> Array:
        """Arc s in [0, 1] of every robot at the common instants t (K,) s, (n, K)."""
        since = t - self.task.coast[:, None]
        return self._arcs(motion.rates[:, None], since)

    def arcs(self, motion: FormationMotion, robots: NDArray[np.intp], t: Array) -> Array:
        """Arcs s in [0, 1] of `robots` (r,) at the instants t (r,) s, (r,)."""
        return self._arcs(motion.rates[robots], t - self.task.coast[robots])

    def _arcs(self, rates: Array, since: Array) -> Array:
        """Invert the time since the manoeuvre began (...) s, with rates (..., q + 1)."""
        if self.degree == 0:
            return np.asarray(np.clip(since / rates[..., 0], 0.0, 1.0))

        def time(s: Array) -> Array:
            return np.asarray((bernstein_integral(self.degree, s) * rates).sum(axis=-1))

        def speed(s: Array) -> Array:
            return np.asarray(1.0 / (bernstein_basis(self.degree, s) * rates).sum(axis=-1))

        return invert_time(time, speed, since, rates.mean(axis=-1))

    def position_at(self, motion: FormationMotion, t: Array) -> Array:
        """Positions at the common instants t (K,), coasting before and parked after, (n, 2, K)."""
        values = self.values(self.arc_at(motion, t))
        value: Array = motion.position @ np.swapaxes(values, 1, 2)
        if self.task.coast.any():
            early = np.minimum(t - self.task.coast[:, None], 0.0)
            value = value + self.task.velocity[..., None] * early[:, None, :]
        return value

    def points(
        self, motion: FormationMotion, robots: NDArray[np.intp], s: Array, at_fixed_time: bool
    ) -> tuple[Array, Array]:
        """
        Positions (r, 2) of `robots` (r,) at the arcs s (r,), and d/dz (r, 2, P).

        The derivative is taken at a fixed instant of time, or at a fixed arc.
        """
        values = self.values(s)
        ends = motion.position[robots]
        value = (ends @ values[..., None])[..., 0]
        jacobian = np.zeros((s.size, 2, self.size))
        shapes = values @ self.basis.free * self.length_scale
        for axis in range(2):
            first = self.nb + axis * self.nf
            last = first + self.nf
            jacobian[:, axis, first:last] = shapes
        if self.moving_start:
            slope = np.einsum('rdbm,rm->rdb', motion.position_slope[robots], values)
            jacobian[:, :, : self.nb] = slope * self.time_scale
        if at_fixed_time:
            speed = (ends @ self.values(s, 1)[..., None])[..., 0]
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
