# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

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

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.bases import PolynomialBasis
from tdm_planner.direct_method.output_basis import OrthonormalBasis, VariedPolynomials
from tdm_planner.direct_method.virtual_arc import bernstein_basis, bernstein_integral, invert_time
from tdm_planner.problems.formation_task import FormationTask

Array = NDArray[np.float64]

_YAW_SCALE = 10.0
_NODES = 24  # of the quadrature of a fit


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

    @property
    def points(self) -> int:
        """Return the number of nodes at which limits are kept and gas is summed."""
        return self.nodes or max(21, 5 * self.order - 14)

    def of_order(self, order: int) -> MotionForm:
        """Return the form with polynomials of another order, on as many nodes as that needs."""
        return self if order == self.order else self._replace(order=order, nodes=None)


DEFAULT_FORM: Final = MotionForm()


class LocalVariables(NamedTuple):
    """
    What a robot's terms at A arcs depend on, see `robot_statement`: W numbers at each.

    They are `slopes` (A, W, P) times the varied parameters and `ends` (A, W, 6) times departure
    and goal of x, y and yaw; `at` (A, ...) is what velocity and acceleration at the start
    contribute to every derivative of position, then of yaw.
    """

    slopes: Array
    ends: Array
    at: Array

    @classmethod
    def of(
        cls, form: MotionForm, s: Array, speed: int = 0, position: int = 0, yaw: int = 0
    ) -> LocalVariables:
        """
        Tabulate them at the arcs s (A,), with so many derivatives of each.

        Those of mu come first, from mu on, and mu, mu_s at the start; then x_s, y_s and yaw_s on.
        """
        ends = end_derivatives(form.order, form.vary_ends)
        turns = end_derivatives(form.yaw_order, False)
        rates = [bernstein_basis(form.degree, s, d) for d in range(speed)]
        rates += [np.broadcast_to(basis, rates[0].shape) for basis in departing(form.degree)]
        paths = [ends.basis.values(s, d + 1) for d in range(position)]
        angles = [turns.basis.values(s, d + 1) for d in range(yaw)]
        nb, nf, ny = form.degree + 1, ends.free.shape[1], turns.free.shape[1]
        shape = s.size, len(rates) + 2 * position + yaw
        slopes, fixed = np.zeros((*shape, nb + 2 * nf + ny)), np.zeros((*shape, 6))
        slopes[:, : len(rates), :nb] = np.stack(rates, axis=1)
        row, column = len(rates), nb
        for axis, (of, derivatives) in enumerate([(ends, paths), (ends, paths), (turns, angles)]):
            last = column + of.free.shape[1]
            for values in derivatives:
                slopes[:, row, column:last] = values @ of.free
                fixed[:, row, [2 * axis, 2 * axis + 1]] = values[:, [0, of.goal]]
                row += 1
            column = last
        given = [1.0, 0.0 if form.vary_ends else 1.0]
        at = [v[:, 1:3] * given for v in paths] + [v[:, 1:3] for v in angles]
        return cls(slopes, fixed, np.concatenate(at, axis=1))


@dataclass(frozen=True, eq=False)
class FormationMotion:
    """
    The motions of all robots at one set of varied parameters.

    `rates` (n, q + 1): the coefficients b of mu [s]; `position` (n, 2, order + 1) and `yaw`
    (n, yaw order + 1): end derivatives by s.
    """

    rates: Array
    position: Array
    yaw: Array

    @property
    def durations(self) -> Array:
        """Time each manoeuvre takes, without coasting (n,) s: the integral of mu."""
        return np.asarray(self.rates.mean(axis=1))


def departing(degree: int) -> list[Array]:
    """Return mu and mu_s at the start by the coefficients b, (q + 1,) each."""
    return [bernstein_basis(degree, 0.0, d) for d in range(2)]


class ReferenceMotion:
    """
    Map from a robot's varied parameters (P,) to its motion, for all n robots at once.

    The varied parameters of one robot are b (q + 1), q of x (nf), of y (nf), of yaw (ny), in units
    of `scales` (P,).
    """

    def __init__(self, task: FormationTask, form: MotionForm = DEFAULT_FORM) -> None:
        self.task, self.form = task, form
        self.order, self.degree, self.vary_ends = form.order, form.degree, form.vary_ends
        self.basis = end_derivatives(form.order, form.vary_ends)
        self.yaw_basis = end_derivatives(form.yaw_order, False)
        self.departing = departing(self.degree)
        self.nb, self.nf = self.degree + 1, self.basis.free.shape[1]
        self.ny = self.yaw_basis.free.shape[1]
        self.size = self.nb + 2 * self.nf + self.ny
        self.time_scale, self.length_scale = _scales(task)
        self.scales = np.repeat(
            [self.time_scale, self.length_scale, _YAW_SCALE], [self.nb, 2 * self.nf, self.ny]
        )

    def with_task(self, task: FormationTask) -> ReferenceMotion:
        """Return the same reference functions for another manoeuvre."""
        return ReferenceMotion(task, self.form)

    def fit(self, b: Array, bend: Callable[[Array], Array]) -> Array:
        """
        Varied parameters (n, P) of rates b (n, q + 1) s whose motions bend most as wanted.

        `bend` gives the second derivatives (n, 2, K) at arcs s (K,). The yaw is at rest.
        """
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        s = (nodes + 1) / 2
        base = self.unpack(self.pack(b, np.zeros((len(b), 2, self.nf)))).position
        curvature = self.values(s, 2)
        missed = (bend(s) - base @ curvature.T) * (weights / 2)
        return self.pack(b, missed @ (curvature @ self.basis.free))

    def raise_order(self, low: ReferenceMotion, z: Array) -> Array:
        """Varied parameters (n, P) of the same motions as `low` with z, of lower order, has."""
        motion = low.unpack(z)
        raised = self.fit(motion.rates, lambda s: motion.position @ low.values(s, 2).T)
        if self.ny:
            own, its = self.size - self.ny, low.size - low.ny
            raised[:, own:] = z[:, its:]
        return raised

    def unpack(self, z: Array) -> FormationMotion:
        """Motions at the scaled varied parameters z (n, P)."""
        task, n = self.task, self.task.n
        last = self.nb + 2 * self.nf
        b, shape, turned = np.split(z * self.scales, [self.nb, last], axis=1)
        mu, slope = ((b @ basis)[:, None] for basis in self.departing)
        position = shape.reshape(n, 2, self.nf) @ self.basis.free.T
        position[..., 0], position[..., self.basis.goal] = task.departure, task.goal
        position[..., 1] = mu * task.velocity
        if not self.vary_ends:
            position[..., 2] = mu**2 * task.acceleration + slope * task.velocity
        yaw = turned @ self.yaw_basis.free.T
        yaw[:, 0], yaw[:, self.yaw_basis.goal] = task.departure_yaw, task.goal_yaw
        yaw[:, 1] = mu[:, 0] * task.yaw_rate
        yaw[:, 2] = mu[:, 0] ** 2 * task.yaw_acceleration + slope[:, 0] * task.yaw_rate
        return FormationMotion(b, position, yaw)

    def values(self, s: Array, derivative: int = 0) -> Array:
        """Polynomials of x and y by their end derivatives, at s (...), (..., order + 1)."""
        return self.basis.basis.values(s, derivative)

    def yaw_values(self, s: Array, derivative: int = 0) -> Array:
        """Polynomials of the attitude by their end derivatives, (..., yaw order + 1)."""
        return self.yaw_basis.basis.values(s, derivative)

    def speed_basis(self, s: Array, derivative: int) -> Array:
        """Bernstein polynomials or a derivative of them at s (...)."""
        return bernstein_basis(self.degree, s, derivative)

    def arc_at(self, motion: FormationMotion, t: Array) -> Array:
        """Arc s in [0, 1] of every robot at the common instants t (K,) s, (n, K)."""
        rates, since = motion.rates[:, None], t - self.task.coast[:, None]

        def time(s: Array) -> Array:
            return np.asarray((bernstein_integral(self.degree, s) * rates).sum(axis=-1))

        def speed(s: Array) -> Array:
            return np.asarray(1.0 / (bernstein_basis(self.degree, s) * rates).sum(axis=-1))

        return invert_time(time, speed, since, rates.mean(axis=-1))

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
