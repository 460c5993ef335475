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

"""Gas and thrust limits of the robots: values, gradients and the Hessian of their Lagrangian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.inverse_dynamics import (
    InverseDynamics,
    NodeSlopes,
    NodeValues,
    norm_hessian,
)

Array = NDArray[np.float64]

GAS_SMOOTHING = 0.03  # share of F_max by which |F| is rounded off at zero
THRUST_SHARE = 0.99  # of F_max planned with: what lies between nodes, and repairs, need the rest


class GasAndThrust:
    """Gas by quadrature with `weights` (K,), and |F| <= F_max, at the nodes of `dynamics`."""

    def __init__(self, dynamics: InverseDynamics, weights: Array) -> None:
        self.dynamics, self.weights = dynamics, weights
        thrust = dynamics.model.task.thrust
        self.rest = GAS_SMOOTHING * thrust
        self.limit = THRUST_SHARE * thrust

    def _rounded(self, values: NodeValues) -> Array:
        """|Y_xy| rounded off at zero (n, K)."""
        return np.sqrt(values.force**2 + (self.rest * values.mu) ** 2)

    def gas(self, values: NodeValues) -> Array:
        """Gas of every robot, rounded off where there is no thrust (n,) m/s."""
        return np.asarray(self._rounded(values) @ self.weights)

    def margins(self, values: NodeValues) -> Array:
        """1 - F / F_max at every node (n, K)."""
        return np.asarray(1.0 - values.force / (self.limit * values.mu))

    def margin_rows(
        self, values: NodeValues, y_slope: Array, i: NDArray[np.intp], k: NDArray[np.intp]
    ) -> Array:
        """Margins of robots i at nodes k differentiated (r, P), Y's slopes being `y_slope`."""
        limit = self.limit * values.mu[i, k]
        unit = values.y[i, :2, k] / np.maximum(values.force[i, k], 1e-9)[:, None]
        rows = -np.einsum('rd,rdp->rp', unit, y_slope[i, :2, k]) / limit[:, None]
        share = values.force[i, k] / limit / values.mu[i, k]
        return np.asarray(rows + share[:, None] * self.dynamics.mu_jacobian[k])

    def derivatives(
        self, values: NodeValues, slopes: NodeSlopes, weight: float, dual: Array | None
    ) -> tuple[Array, Array]:
        """
        Gradient (n, P) of `weight` times the gas, and Hessian (n, P, P) of the Lagrangian.

        `dual` (n, K), if given, holds the multipliers of the margins.
        """
        dmu, n = self.dynamics.mu_jacobian, len(values.mu)
        weights, smooth = weight * self.weights, self._rounded(values)
        level = np.broadcast_to(self.rest * dmu, (n, 1, *dmu.shape))
        scaled = np.concatenate([slopes.y[:, :2], level], axis=1)
        unit = np.concatenate([values.y[:, :2], (self.rest * values.mu)[:, None]], axis=1)
        unit = unit / smooth[:, None]
        along = np.einsum('ndk,ndkp->nkp', unit, scaled)
        gradient = np.einsum('k,nkp->np', weights, along)
        hessian = norm_hessian(scaled, along, weights / smooth)
        pull = weights * unit[:, :2]
        if dual is not None:
            added, more = self._limit_hessian(values, slopes, dual)
            hessian, pull = hessian + added, pull + more
        return gradient, hessian + self.dynamics.curvature(values, slopes, pull)

    def _limit_hessian(
        self, values: NodeValues, slopes: NodeSlopes, dual: Array
    ) -> tuple[Array, Array]:
        """Hessian of -dual times the margins with Y linear, and the pull (n, 2, K) on Y's own."""
        dmu, mu = self.dynamics.mu_jacobian, values.mu
        force = np.maximum(values.force, 1e-6 * self.limit * mu)
        unit = values.y[:, :2] / force[:, None]
        along = np.einsum('ndk,ndkp->nkp', unit, slopes.y[:, :2])
        factor = dual / (self.limit * mu)
        hessian = norm_hessian(slopes.y[:, :2], along, factor / force)
        cross = np.einsum('nk,nkp,kr->npr', factor / mu, along, dmu)
        hessian -= cross + np.swapaxes(cross, 1, 2)
        hessian += np.einsum('nk,kp,kr->npr', 2 * factor * force / mu**2, dmu, dmu)
        return hessian, factor[:, None] * unit
