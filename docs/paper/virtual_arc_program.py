# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The swing-up along a virtual arc as the nonlinear program (10): the scheme (9)-(16), mended.

theta = P(tau) is a monotone reference function of the virtual arc, 0 <= tau <= 1, and the torque
alternates between its extremes at varied points of the arc. As printed, the scheme leaves no
freedom and divides by zero: torque and initial state already determine theta(t), so that P only
says where the nodes lie, and the speed factor lambda = theta'/P' is 0/0 at rest. Mended:

- the state is E = theta'^2, which the equations of motion determine: dE/dtheta = 2 theta'';
- P' vanishes where the pendulum rests and nowhere else, so that lambda stays finite;
- nodes lie at the switches, which makes the result differentiable by them.

Xi = (d_1, ..., d_(K-1)), the lengths along tau of all arcs of constant torque but the last;
J = w0 t_f; equalities E = psi = psi' = 0 upright; along the way E >= 0 and |psi| <= psi_max.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pendulum_arc_kernel import advance_along
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.problems.pendulum.task import SwingUpTask

Array = NDArray[np.float64]
Values = NDArray[Any]

LEAST_SPEED = 1e-4  # of w0, see VirtualArcProgram
_DIFFERENCE = 1e-6  # step of the directional differences of the Jacobian
_SMALLEST_CURVATURE = 2e-2
_NEAR_REST = 0.1  # of w0^2, energy below which an arc's slowest node gets a row
_NEAR_LIMIT = 0.3  # [rad] from psi_max within which an arc's peak gets a row
_EQUALITIES = 3


def reference_shape(tau: Values, slope: float) -> Values:
    """Monotone cubic from 0 to 1 with P'(0) = `slope` in [0, 2] and P'(1) = 0."""
    return tau * (slope + tau * (3.0 - 2.0 * slope + tau * (slope - 2.0)))


@dataclass(frozen=True, eq=False)
class _Rows:
    """What `evaluate` keeps: equalities, margins, and the nodes that the margins are taken at."""

    equalities: Array
    margins: Array
    slowest: NDArray[np.intp]
    peaks: NDArray[np.intp]


def jacobians(function: Any, points: Array, _scheme: str) -> Array:
    """Return derivatives at points (B, n) by complex step, (B, m, n)."""
    count, size = points.shape
    moved = (points[:, None, :] + 1e-40j * np.eye(size)).reshape(-1, size)
    slopes = function(moved).imag / 1e-40
    return np.swapaxes(slopes.reshape(count, size, -1), 1, 2)


class VirtualArcProgram(NonlinearProgram):
    """
    The nonlinear program for one sequence of torques and one goal theta = 2 pi `turns`.

    `torques` (K,) [N m] are those of the arcs, `steps` the nodes an arc. Slower than `floor` (in
    units of w0) the pendulum counts as that fast, save where it rests: guesses far from the
    solution lead to angles beyond reach, where E is negative.
    """

    def __init__(
        self,
        task: SwingUpTask,
        torques: Array,
        turns: int,
        steps: int,
        floor: float = LEAST_SPEED,
    ) -> None:
        self.task = task
        self.torques = torques
        self.turns = turns
        self.steps = steps
        self.lower, self.upper = np.zeros(torques.size - 1), np.ones(torques.size - 1)
        w0 = self._w0 = task.plant.natural_frequency
        self._least = (floor * w0) ** 2
        self._coefficients = task.plant.coefficients
        speed = abs(float(task.start[2])) / w0
        self._slope = 2.0 * speed / (speed + abs(self._way)) if speed else 0.0

    @property
    def _way(self) -> float:
        """Angle from start to goal [rad], signed."""
        return float(2.0 * np.pi * self.turns - self.task.start[0])

    def angles(self, xi: Values) -> Values:
        """Angles theta at nodes of candidates (B, K - 1), even along every arc: (B, N)."""
        lengths = np.concatenate([xi, 1.0 - xi.sum(axis=1, keepdims=True)], axis=1)
        ends = np.cumsum(lengths, axis=1)
        shares = np.arange(1, self.steps + 1) / self.steps
        tau = (ends - lengths)[:, :, None] + lengths[:, :, None] * shares
        tau = np.concatenate([np.zeros((len(xi), 1)), tau.reshape(len(xi), -1)], axis=1)
        return np.asarray(self.task.start[0] + self._way * reference_shape(tau, self._slope))

    def along(self, xi: Values, to_rest: bool = True) -> Values:
        """
        (E, psi, psi', t) at the nodes of candidates (B, K - 1): (B, N, 4), N = K steps + 1.

        Without `to_rest` the pendulum may pass the goal, as it does under a given torque.
        """
        theta = self.angles(xi)
        states = np.zeros((*theta.shape, 4), dtype=theta.dtype)
        _, psi, theta_dot, psi_dot = self.task.start
        states[:, 0, :3] = theta_dot**2, psi, psi_dot
        torques = np.repeat(self.torques, self.steps)
        advance_along(
            self._coefficients,
            theta,
            bool(theta_dot == 0.0),
            to_rest,
            torques,
            self._least,
            states,
        )
        return states

    def durations(self, xi: Array) -> Array:
        """Durations (K,) [s] of the arcs of constant torque."""
        return np.diff(self.along(xi[None])[0, :: self.steps, 3])

    def evaluate(self, xi: Array) -> Point:
        """Return the scaled time; violations of the ends (group 0) and along the way (group 1)."""
        states = self.along(xi[None])
        arcs = states[0, 1:].reshape(-1, self.steps, 4)
        first = 1 + self.steps * np.arange(len(arcs))
        energy = arcs[:, :, 0].copy()
        energy[-1, -1] = np.inf  # an equality
        slowest = first + energy.argmin(axis=1)
        peaks = first + np.abs(arcs[:, :, 1]).argmax(axis=1)
        values = self._values(xi[None], states, slowest, peaks)[0]
        if not np.isfinite(values).all():
            return Point(xi, np.inf, np.full(2, np.inf))
        ends = 1 + _EQUALITIES
        rows = _Rows(values[1:ends], values[ends:], slowest, peaks)
        worst = np.array([np.abs(rows.equalities).max(), max(-rows.margins.min(), 0.0)])
        return Point(xi, float(values[0]), worst, rows, rows.equalities, rows.margins)

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """First derivatives, and the Hessian reduced to the null space of the equalities."""
        rows: _Rows = point.cache
        jacobian = self._jacobians(point.xi[None], rows)[0]
        equalities, margins = np.split(jacobian[1:], [_EQUALITIES])
        near = np.repeat([1.0, _NEAR_REST, _NEAR_LIMIT], [1, rows.slowest.size, rows.peaks.size])
        kept = np.flatnonzero(rows.margins < near)
        if multipliers is None:
            found = np.linalg.lstsq(equalities.T, -jacobian[0], rcond=1e-6)
            duals = np.asarray(found[0], dtype=np.float64)
        else:
            duals = multipliers.equalities
        count = point.xi.size
        return Linearisation(
            gradient=jacobian[0],
            hessian=self._hessian(point.xi, rows, jacobian, duals),
            equalities=rows.equalities,
            equality_jacobian=equalities,
            inequalities=rows.margins[kept],
            inequality_jacobian=margins[kept],
            inequality_groups=np.ones(kept.size, dtype=np.intp),
            tags=kept,
            evaluations=count * max(1 + count - _EQUALITIES, 1),
        )

    def _values(
        self, xi: Values, states: Values, slowest: NDArray[np.intp], peaks: NDArray[np.intp]
    ) -> Values:
        """Scaled time, equalities, margins (last arc's length, energies, |psi|), of candidates."""
        w0, end, psi = self._w0, states[:, -1], states[:, peaks, 1]
        return np.concatenate(
            [
                w0 * end[:, 3:],
                end[:, :3] / [w0**2, 1.0, w0],
                1.0 - xi.sum(axis=1, keepdims=True),
                states[:, slowest, 0] / w0**2,
                self.task.planned_disk_angle - np.where(psi.real < 0.0, -psi, psi),
            ],
            axis=1,
        )

    def _jacobians(self, points: Array, rows: _Rows) -> Array:
        """Return derivatives of all values at points (B, n), margins at the nodes of `rows`."""
        return jacobians(
            lambda xi: self._values(xi, self.along(xi), rows.slowest, rows.peaks),
            points,
            'complex_step',
        )

    def _hessian(self, xi: Array, rows: _Rows, jacobian: Array, duals: Array) -> Array:
        """Curvature of the Lagrangian along the equalities, by directional differences."""
        used, weights = 1 + _EQUALITIES, np.concatenate([[1.0], duals])
        _, _, basis = np.linalg.svd(jacobian[1:used])
        across, along = basis[:_EQUALITIES], basis[_EQUALITIES:]
        hessian: Array = _SMALLEST_CURVATURE * (across.T @ across)
        if not len(along):
            return hessian
        moved = self._jacobians(xi + _DIFFERENCE * along, rows)[:, :used]
        change = np.einsum('m,bmk->bk', weights, moved - jacobian[:used]) / _DIFFERENCE
        reduced = np.nan_to_num(change @ along.T)
        values, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
        directions = along.T @ vectors
        curvatures = np.clip(np.abs(values), _SMALLEST_CURVATURE, 1e6)
        hessian += (directions * curvatures) @ directions.T
        return hessian
