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
The swing-up with a smooth torque as the nonlinear program (10).

The disk's angle is a polynomial reference function of s = t/t_f whose end values and velocities
are prescribed and whose further end derivatives are varied,

    psi(s) = psi_0 h_0(s) + t_f psi'_0 h_1(s) + a t_f^2 sum_k r_k phi_k(s),

a = T_max A / D being the acceleration the torque gives the disk upright and phi_k the shapes of
the varied end derivatives, orthonormal in their second derivatives. The torque follows by inverse
dynamics, theta is integrated. Xi = (w0 t_f, r); J = w0 t_f; equalities theta = 2 pi n, theta' = 0
at the end, and T = T_0 at the start where that is given; |T| <= T_max and |psi| <= psi_max along
the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.direct_method.polynomial import PolynomialBasis
from tdm_planner.plants.driven_pendulum import drive_pendulum
from tdm_planner.problems.swing_up_task import SwingUpTask
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

VARIED = (2, 3, 4, 5, 6, 7)  # orders of the end derivatives that are varied, at both ends
_CURVATURE = 1e-2  # of the model of J, for want of second derivatives
_START_SHARE = 0.98  # of the torque that may be used, beyond which a start torque is not kept
_NEAR_LIMIT = 0.4  # share of a limit within which a node gets a row


class _Shapes(NamedTuple):
    """The shapes and their first two derivatives by s at the nodes: (n, 2) and (n, nr) each."""

    given: tuple[Array, Array, Array]
    varied: tuple[Array, Array, Array]


@lru_cache(maxsize=16)
def _shapes(nodes: int) -> _Shapes:
    s = np.linspace(0.0, 1.0, nodes)
    basis = PolynomialBasis.of((0, 1, *VARIED), (0, 1, *VARIED))
    half = 2 + len(VARIED)
    free = [*range(2, half), *range(half + 2, 2 * half)]
    points, weights = np.polynomial.legendre.leggauss(2 * half)
    curvature = basis.values((points + 1) / 2, 2)[:, free]
    factor = np.linalg.cholesky(curvature.T @ (weights[:, None] / 2 * curvature))
    orthonormal = np.linalg.inv(factor).T
    values = [basis.values(s, derivative) for derivative in range(3)]
    given = (values[0][:, :2], values[1][:, :2], values[2][:, :2])
    first, second, third = (value[:, free] @ orthonormal for value in values)
    return _Shapes(given, (first, second, third))


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion at the nodes of the integration: states (M + 1, 4), torque (M + 1,), derivatives."""

    states: Array
    torque: Array
    states_jacobian: Array  # (M + 1, 4, P)
    torque_jacobian: Array  # (M + 1, P)


class SmoothProgram(NonlinearProgram):
    """
    The nonlinear program for one goal `turns`, integrated by `steps` RK4 steps.

    `torque_share` of the task's torque may be used at the nodes, so that it is kept between them.
    """

    def __init__(
        self, task: SwingUpTask, turns: int, steps: int, torque_share: float = 0.99
    ) -> None:
        self.task = task
        self.turns = turns
        self.steps = steps
        self.limit = torque_share * task.torque
        self.evaluations = 0
        size = 1 + 2 * len(VARIED)
        self.lower, self.upper = np.full(size, -50.0), np.full(size, 50.0)
        self.lower[0], self.upper[0] = 1e-3, 1e3
        self._shapes = _shapes(2 * steps + 1)
        self._start_torque = task.start_torque
        if task.start_torque is not None:
            most = _START_SHARE * self.limit
            self._start_torque = min(max(task.start_torque, -most), most)

    def motion(self, xi: Array) -> Motion:
        """Disk from the reference function, pendulum by integration, torque by inversion."""
        plant, start = self.task.plant, self.task.start
        w0 = plant.natural_frequency
        t_f = xi[0] / w0
        disk, slopes = self._disk(t_f, xi[1:])
        slopes[:, :, 0] /= w0
        step_slopes = np.zeros(xi.size)
        step_slopes[0] = 1.0 / (w0 * self.steps)
        pendulum, pendulum_slopes = drive_pendulum(
            plant,
            start[::2].copy(),
            np.ascontiguousarray(disk[:, 1:]),
            np.ascontiguousarray(slopes[:, 1:]),
            t_f / self.steps,
            step_slopes,
        )
        disk, slopes = disk[::2], slopes[::2]
        states = np.stack([pendulum[:, 0], disk[:, 0], pendulum[:, 1], disk[:, 1]], axis=1)
        jacobian = np.stack(
            [pendulum_slopes[:, 0], slopes[:, 0], pendulum_slopes[:, 1], slopes[:, 1]], axis=1
        )
        torque, _ = plant.torque_for(states, disk[:, 2])
        # psi'' = f(x, T), so that dT = (dpsi'' - f_x dx) / f_T.
        by_state, by_torque = plant.jacobians(states, torque[:, None])
        torque_jacobian = (
            slopes[:, 2] - np.einsum('ni,nip->np', by_state[:, 3], jacobian)
        ) / by_torque[:, 3]
        return Motion(states, torque, jacobian, torque_jacobian)

    def _disk(self, t_f: float, r: Array) -> tuple[Array, Array]:
        """Angle, velocity, acceleration of the disk (n, 3), derivatives by t_f, r (n, 3, P)."""
        _, psi, _, psi_dot = self.task.start
        a = self.task.disk_acceleration
        given, varied = self._shapes
        disk = np.empty((len(given[0]), 3))
        slopes = np.empty((len(given[0]), 3, 1 + r.size))
        for order, (h, phi) in enumerate(zip(given, varied, strict=True)):
            shape = phi @ r
            disk[:, order] = (
                h[:, 0] * psi * t_f**-order
                + h[:, 1] * psi_dot * t_f ** (1 - order)
                + a * t_f ** (2 - order) * shape
            )
            slopes[:, order, 0] = (
                -order * h[:, 0] * psi * t_f ** (-order - 1)
                + (1 - order) * h[:, 1] * psi_dot * t_f**-order
                + (2 - order) * a * t_f ** (1 - order) * shape
            )
            slopes[:, order, 1:] = a * t_f ** (2 - order) * phi
        return disk, slopes

    def _residual(self, motion: Motion) -> Array:
        theta, _, theta_dot, _ = motion.states[-1]
        w0 = self.task.plant.natural_frequency
        residual = [theta - 2 * np.pi * self.turns, theta_dot / w0]
        if self._start_torque is not None:
            residual.append((motion.torque[0] - self._start_torque) / self.task.torque)
        return np.array(residual)

    def _residual_jacobian(self, motion: Motion) -> Array:
        ends = motion.states_jacobian[-1]
        rows = [ends[0], ends[2] / self.task.plant.natural_frequency]
        if self._start_torque is not None:
            rows.append(motion.torque_jacobian[0] / self.task.torque)
        return np.stack(rows)

    def fit(self, trajectory: Trajectory) -> Array:
        """Return the varied parameters whose disk moves most like that of a trajectory."""
        t_f, a = trajectory.duration, self.task.disk_acceleration
        _, psi, _, psi_dot = self.task.start
        given, varied = self._shapes.given[2], self._shapes.varied[2]
        sample = trajectory.sample(trajectory.times[0] + np.linspace(0.0, t_f, len(given)))
        wanted = self.task.plant.derivative(sample.state, sample.control)[:, 3]
        wanted = wanted - given[:, 0] * psi / t_f**2 - given[:, 1] * psi_dot / t_f
        shapes, *_ = np.linalg.lstsq(a * varied, wanted, rcond=None)
        return np.concatenate([[t_f * self.task.plant.natural_frequency], shapes])

    def _margins(self, motion: Motion) -> Array:
        """Shares of the limits left at the nodes: torque, then disk angle, (2 M + 2,)."""
        torque = 1.0 - np.abs(motion.torque) / self.limit
        angle = 1.0 - np.abs(motion.states[:, 1]) / self.task.planned_disk_angle
        angle[0] = max(angle[0], 0.0)
        return np.concatenate([torque, angle])

    def evaluate(self, xi: Array) -> Point:
        """Return the scaled time; violations of the ends (group 0) and of the limits (group 1)."""
        self.evaluations += 1
        with np.errstate(all='ignore'):
            motion = self.motion(xi)
            ends = np.abs(self._residual(motion)).max()
            limits = max(float(-self._margins(motion).min()), 0.0)
        violations = np.array([ends, limits])
        if not np.isfinite(violations).all():
            violations = np.full(2, np.inf)
        return Point(xi, float(xi[0]), violations, motion)

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """First derivatives; the curvature is a constant."""
        motion: Motion = point.cache
        margins = self._margins(motion)
        near = np.flatnonzero(margins < _NEAR_LIMIT)
        rows = np.concatenate(
            [
                -np.sign(motion.torque)[:, None] * motion.torque_jacobian / self.limit,
                -np.sign(motion.states[:, 1])[:, None]
                * motion.states_jacobian[:, 1]
                / self.task.planned_disk_angle,
            ]
        )
        gradient = np.zeros(point.xi.size)
        gradient[0] = 1.0
        return Linearisation(
            gradient=gradient,
            hessian=_CURVATURE * np.eye(point.xi.size),
            equalities=self._residual(motion),
            equality_jacobian=self._residual_jacobian(motion),
            inequalities=margins[near],
            inequality_jacobian=rows[near],
            inequality_groups=np.ones(near.size, dtype=np.intp),
            tags=near,
        )

    def correction_rows(
        self, point: Point, at: Linearisation, active: NDArray[np.bool_]
    ) -> Array | None:
        """Residuals of the ends and of the nodes whose limits were active."""
        motion: Motion = point.cache
        limits = self._margins(motion)[at.tags[active]]
        return np.concatenate([self._residual(motion), np.minimum(limits, 0.0)])
