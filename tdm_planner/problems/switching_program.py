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
The swing-up as the nonlinear program (10): the varied parameters are the switching times.

Xi = w0 (d_1, ..., d_K), the durations of arcs of alternating extreme torque; J = sum Xi. The
argument tau is time itself: torque and initial state already determine the motion, so that the
states follow by integration and the terminal conditions become equalities,

    (theta - 2 pi n, psi, theta'/w0, psi'/w0) = 0 at the end,  |psi| <= psi_max along every arc.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.plants.pendulum_rollout import roll, roll_ends
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems.switching_motion import (
    ArcProgram,
    DIFFERENCE,
    NEAR_LIMIT,
    SMALLEST_CURVATURE,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Motion:
    """What `evaluate` keeps: residuals of the ends with derivatives, peaks of the arcs."""

    residual: Array  # (4,)
    jacobian: Array  # (4, K)
    margins: Array  # (K,), psi_max - the largest |psi| of every arc; infinite if far
    margins_jacobian: Array  # (K, K)


class SwitchingProgram(NonlinearProgram):
    """
    The nonlinear program for one sequence of torques.

    `start` (4,), `torques` (K,) [N m], `turns` the n of theta = 2 pi n, `disk_angle` the limit of
    |psi| [rad], `steps` the number of RK4 steps an arc.
    """

    def __init__(
        self,
        plant: RotaryPendulum,
        start: Array,
        torques: Array,
        turns: int,
        disk_angle: float,
        steps: int,
    ) -> None:
        self.plant = plant
        self.start = start
        self.torques = torques
        self.turns = turns
        self.disk_angle = disk_angle
        self.steps = steps
        self.lower = np.zeros(torques.size)
        self.upper = np.full(torques.size, np.inf)
        self.evaluations = 0
        w0 = plant.natural_frequency
        self._scale = np.array([1.0, 1.0, 1.0 / w0, 1.0 / w0])
        # Margins of all arcs where the disk is far from its limit.
        self._far = np.full(torques.size, np.inf), np.zeros((torques.size, torques.size))

    @property
    def numbers(self) -> ArcProgram:
        """Return the program as the compiled minimiser takes it."""
        return ArcProgram(
            k=np.array(self.plant.coefficients),
            start=self.start,
            torques=self.torques,
            goal=2.0 * math.pi * self.turns,
            disk_angle=self.disk_angle,
            w0=self.plant.natural_frequency,
            steps=self.steps,
        )

    def evaluate(self, xi: Array) -> Point:
        """Return the scaled time, and violations of the ends (group 0) and of |psi| (group 1)."""
        self.evaluations += 1
        w0 = self.plant.natural_frequency
        states, sensitivities = roll(self.plant, self.start, xi / w0, self.torques, self.steps)
        residual = states[-1] * self._scale
        residual[0] -= 2 * np.pi * self.turns
        sensitivities = sensitivities / w0
        jacobian = sensitivities[-1] * self._scale[:, None]
        ends, beyond = float(np.abs(residual).max()), 0.0
        if np.abs(states[1:, 1]).max() < self.disk_angle - NEAR_LIMIT:
            motion = _Motion(residual, jacobian, *self._far)
        else:
            heights, slopes = _peaks(states, sensitivities, xi / w0, self.steps, w0)
            motion = _Motion(residual, jacobian, self.disk_angle - heights, -slopes)
            beyond = max(float(-motion.margins.min()), 0.0)
        if not math.isfinite(ends + beyond):
            ends = beyond = math.inf
        return Point(xi, float(xi.sum()), np.array([ends, beyond]), motion)

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """First derivatives, and the Hessian reduced to the null space of the end conditions."""
        motion: _Motion = point.cache
        near = np.flatnonzero((motion.margins < NEAR_LIMIT) & (point.xi > 0))
        if multipliers is None:
            varied = point.xi > 1e-7
            least_squares = np.linalg.lstsq(
                motion.jacobian[:, varied].T, -np.ones(int(varied.sum())), rcond=1e-6
            )
            duals = np.asarray(least_squares[0], dtype=np.float64)
        else:
            duals = multipliers.equalities
        return Linearisation(
            gradient=np.ones(point.xi.size),
            hessian=self._hessian(point.xi, motion.jacobian, duals),
            equalities=motion.residual,
            equality_jacobian=motion.jacobian,
            inequalities=motion.margins[near],
            inequality_jacobian=motion.margins_jacobian[near],
            inequality_groups=np.ones(near.size, dtype=np.intp),
            tags=near,
        )

    def _hessian(self, xi: Array, jacobian: Array, duals: Array) -> Array:
        """Curvature of the Lagrangian along the end conditions, by directional differences."""
        _, _, basis = np.linalg.svd(jacobian)
        across, along = basis[:4], basis[4:]
        hessian: Array = SMALLEST_CURVATURE * (across.T @ across)
        if not len(along):
            return hessian
        w0 = self.plant.natural_frequency
        moved = np.ascontiguousarray((xi + DIFFERENCE * along) / w0)
        ends = roll_ends(self.plant, self.start, moved, self.torques, self.steps)
        self.evaluations += len(along)
        weights = duals * self._scale / w0
        change = (np.einsum('m,bmk->bk', weights, ends) - jacobian.T @ duals) / DIFFERENCE
        reduced = change @ along.T
        values, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
        directions = along.T @ vectors
        curvatures = np.maximum(np.abs(values), SMALLEST_CURVATURE)
        hessian += (directions * curvatures) @ directions.T
        return hessian

    def correction_rows(
        self, point: Point, at: Linearisation, active: NDArray[np.bool_]
    ) -> Array | None:
        """Residuals of the ends and of the peaks that were active."""
        motion: _Motion = point.cache
        return np.concatenate([motion.residual, np.minimum(motion.margins[at.tags[active]], 0.0)])


def _peaks(
    states: Array, sensitivities: Array, durations: Array, steps: int, w0: float
) -> tuple[Array, Array]:
    """
    Largest |psi| of every arc (K,) with derivatives by w0 d, (K, K).

    Between the two nodes where psi' changes its sign the peak is that of the parabola through
    psi and both psi'.
    """
    arcs = durations.size
    first = np.arange(arcs) * steps
    node = first + 1 + np.abs(states[1:, 1]).reshape(arcs, steps).argmax(axis=1)
    sign = np.where(states[node, 1] < 0, -1.0, 1.0)
    height = np.abs(states[node, 1])
    slope = sign[:, None] * sensitivities[node, 1]
    speed = sign * states[node, 3]
    left = np.where(speed > 0, node, node - 1)
    right = np.minimum(left + 1, first + steps)
    rising, falling = sign * states[left, 3], sign * states[right, 3]
    inside = (right > left) & (rising > 0) & (falling < 0)
    if not inside.any():
        return height, slope
    left, right, sign = left[inside], right[inside], sign[inside]
    rising, falling = rising[inside], falling[inside]
    h, bend = durations[inside] / steps, rising - falling
    height[inside] = sign * states[left, 1] + 0.5 * h * rising**2 / bend
    by_rising = 0.5 * h * (2 * rising * bend - rising**2) / bend**2
    by_falling = 0.5 * h * rising**2 / bend**2
    slope[inside] = sign[:, None] * (
        sensitivities[left, 1]
        + by_rising[:, None] * sensitivities[left, 3]
        + by_falling[:, None] * sensitivities[right, 3]
    )
    own = np.flatnonzero(inside)
    slope[own, own] += 0.5 * rising**2 / bend / (steps * w0)
    return height, slope
