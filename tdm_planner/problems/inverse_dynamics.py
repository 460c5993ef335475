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
Exact inverse dynamics of the robots at the nodes of their arcs, with derivatives.

With Y = (X_ss - X_s mu_s / mu) / mu a robot's accelerations are X'' = Y / mu, in place of (21) and
(27), which lose the speed factor's slope. Thrust per mass is F = |Y_xy| / mu and the gas, the
integral of F over time, that of |Y_xy| over the arc.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion

Array = NDArray[np.float64]


def clenshaw_curtis(count: int) -> tuple[Array, Array]:
    """Chebyshev-Lobatto nodes on [0, 1] and the weights of Clenshaw-Curtis quadrature."""
    last = count - 1
    angle = np.pi * np.arange(count) / last
    moments = np.zeros(count)
    even = np.arange(0, count, 2)
    moments[even] = 2.0 / (1.0 - even**2)
    cosines = np.cos(np.outer(np.arange(count), angle))
    cosines[[0, -1]] *= 0.5
    weights = (moments @ cosines) * 2.0 / last
    weights[[0, -1]] *= 0.5
    return 0.5 * (1.0 - np.cos(angle)), weights / 2.0


@dataclass(frozen=True)
class NodeValues:
    """Motions at K nodes: mu, mu_s (n, K) s; X_s, X_ss and Y (n, 3, K) of x, y, yaw; |Y_xy|."""

    mu: Array
    mu_slope: Array
    first: Array
    second: Array
    y: Array
    force: Array


class NodeSlopes(NamedTuple):
    """X_s, X_ss and Y differentiated with respect to Z, (n, 3, K, P) each."""

    first: Array
    second: Array
    y: Array


class InverseDynamics:
    """
    Inverse dynamics of a model's motions at the nodes `s` (K,).

    `mu_jacobian`, `mu_slope_jacobian` (K, P): mu and mu_s differentiated with respect to Z.
    """

    def __init__(self, model: ReferenceMotion, s: Array) -> None:
        self.model, self.nodes = model, s
        self.basis = [model.values(s, d) for d in range(3)]
        self.yaw_basis = [model.yaw_values(s, d) for d in range(3)]
        self.speed = [model.speed_basis(s, d) for d in range(2)]
        self.mu_jacobian = self._of_rates(self.speed[0])
        self.mu_slope_jacobian = self._of_rates(self.speed[1])
        self._shapes = [self._shape_jacobian(d) for d in range(3)]

    def _of_rates(self, basis: Array) -> Array:
        jacobian = np.zeros((basis.shape[0], self.model.size))
        jacobian[:, : self.model.nb] = basis * self.model.time_scale
        return jacobian

    def _shape_jacobian(self, derivative: int) -> Array:
        """X, X_s or X_ss differentiated with respect to the scaled shapes, (3, K, P)."""
        model = self.model
        slope = np.zeros((3, self.nodes.size, model.size))
        shapes = self.basis[derivative] @ model.basis.free * model.length_scale
        for axis in range(2):
            begin = model.nb + axis * model.nf
            end = begin + model.nf
            slope[axis, :, begin:end] = shapes
        if model.ny:
            yaw = self.yaw_basis[derivative] @ model.yaw_basis.free * model.yaw_scale
            end = model.nb + 2 * model.nf
            slope[2, :, end:] = yaw
        return slope

    def at(self, motion: FormationMotion) -> NodeValues:
        """Motions at the nodes."""
        mu = motion.rates @ self.speed[0].T
        mu_slope = motion.rates @ self.speed[1].T
        first, second = (
            np.concatenate(
                [motion.position @ self.basis[d].T, (motion.yaw @ self.yaw_basis[d].T)[:, None]],
                axis=1,
            )
            for d in (1, 2)
        )
        y = (second - first * (mu_slope / mu)[:, None]) / mu[:, None]
        return NodeValues(mu, mu_slope, first, second, y, np.hypot(y[:, 0], y[:, 1]))

    def slopes(self, motion: FormationMotion, values: NodeValues) -> NodeSlopes:
        """Differentiate the motions at the nodes."""
        model, nb = self.model, self.model.nb
        first, second = (self._coordinate_slope(motion, d) for d in (1, 2))
        mu = values.mu[:, None, :, None]
        y = second / mu
        by_mu = -values.y
        if model.degree:
            ratio = (values.mu_slope / values.mu)[:, None]
            y -= first * ratio[..., None] / mu
            by_mu = by_mu + values.first * ratio / values.mu[:, None]
            by_slope = -values.first / values.mu[:, None] ** 2
            y[..., :nb] += by_slope[..., None] * self.mu_slope_jacobian[:, :nb]
        y[..., :nb] += (by_mu / values.mu[:, None])[..., None] * self.mu_jacobian[:, :nb]
        return NodeSlopes(first, second, y)

    def _coordinate_slope(self, motion: FormationMotion, derivative: int) -> Array:
        model = self.model
        slope = np.tile(self._shapes[derivative], (model.task.n, 1, 1, 1))
        if model.moving_start:
            by_rate = motion.position_slope @ self.basis[derivative].T * model.time_scale
            slope[:, :2, :, : model.nb] = np.swapaxes(by_rate, 2, 3)
        by_rate = motion.yaw_slope @ self.yaw_basis[derivative].T * model.time_scale
        slope[:, 2, :, : model.nb] = np.swapaxes(by_rate, 1, 2)
        return slope

    def curvature(self, values: NodeValues, slopes: NodeSlopes, pull: Array) -> Array:
        """Sum of `pull` (n, 2, K) times the second derivatives of Y_x and Y_y, (n, P, P)."""
        mu = values.mu[:, None]
        dmu, dslope = self.mu_jacobian, self.mu_slope_jacobian
        by_second = np.einsum('ndk,ndkp->nkp', pull / mu**2, slopes.second[:, :2])
        half = -np.einsum('nkp,kr->npr', by_second, dmu)
        whole = 2 * (pull * values.second[:, :2] / mu**3).sum(axis=1)
        if self.model.degree:
            ratio = values.mu_slope[:, None] / mu
            by_first = np.einsum('ndk,ndkp->nkp', pull / mu**2, slopes.first[:, :2])
            half -= np.einsum('nkp,kr->npr', by_first, dslope)
            by_first = np.einsum('ndk,ndkp->nkp', 2 * pull * ratio / mu**2, slopes.first[:, :2])
            half += np.einsum('nkp,kr->npr', by_first, dmu)
            mixed = 2 * (pull * values.first[:, :2] / mu**3).sum(axis=1)
            half += np.einsum('nk,kp,kr->npr', mixed, dslope, dmu)
            whole -= 6 * (pull * values.first[:, :2] * ratio / mu**3).sum(axis=1)
        total = half + np.swapaxes(half, 1, 2) + np.einsum('nk,kp,kr->npr', whole, dmu, dmu)
        if self.model.moving_start and not self.model.vary_ends:
            total[:, 0, 0] += self._given_curvature(values, pull)
        return np.asarray(total)

    def _given_curvature(self, values: NodeValues, pull: Array) -> Array:
        """Return what b_0^2 times the given initial acceleration adds, (n,)."""
        model = self.model
        bend = np.broadcast_to(self.basis[2], (model.task.n, *self.basis[2].shape))
        bend = bend - self.basis[1] * (values.mu_slope / values.mu)[..., None]
        given = bend[..., 2] / values.mu
        twice = 2 * model.task.acceleration[..., None] * given[:, None]
        return np.asarray(model.time_scale**2 * (pull * twice).sum(axis=(1, 2)))


def norm_hessian(slope: Array, along: Array, weight: Array) -> Array:
    """Sum over nodes of weight (S'S - ss'); S: `slope` (n, d, K, P), s: `along` (n, K, P)."""
    n, d, count, size = slope.shape
    flat = slope.reshape(n, d * count, size)
    weighted = (slope * weight[:, None, :, None]).reshape(n, d * count, size)
    outer = np.swapaxes(along * weight[..., None], 1, 2) @ along
    return np.asarray(np.swapaxes(weighted, 1, 2) @ flat - outer)
