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
The limit of the thruster's rate, |delta| <= delta_max, as rows of the nonlinear program.

The thrust points along N = X_ss mu - X_s mu_s, so that with N_s = X_sss mu - X_s mu_ss

    delta = ((N x N_s) / |N|^2 - yaw_s) / mu.

The rate is worst where the hodograph N(s) passes near the origin: rows are taken at the nearest
approach of every chord of the hodograph, multiplied by |N|^2 and gated where the thrust is so
small that its direction does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion

Array = NDArray[np.float64]

_RATE_SHARE = 0.96  # of the thruster's rate planned with
_GATE = 0.02  # of F_max: below it the direction of the thrust is not limited
_ACTIVE = 0.7


@dataclass(frozen=True)
class HodographValues:
    """Chords' nearest approaches: arcs (n, K - 1), and margins of both limits (n, 2, K - 1)."""

    arcs: Array
    margins: Array


class ThrusterRows:
    """Rows for the chords between the arcs `nodes` (K,)."""

    def __init__(self, model: ReferenceMotion, nodes: Array) -> None:
        self.model, self.nodes = model, nodes
        self.basis = [model.values(nodes, d) for d in range(3)]
        self.speed = [model.speed_basis(nodes, d) for d in range(2)]

    def values(self, motion: FormationMotion) -> HodographValues:
        """Margins at the nearest approaches of all robots that move."""
        model = self.model
        n, count = model.task.n, self.nodes.size - 1
        mu = (motion.rates @ self.speed[0].T)[:, None]
        mu_slope = (motion.rates @ self.speed[1].T)[:, None]
        hodograph = (motion.position @ self.basis[2].T) * mu
        hodograph = hodograph - (motion.position @ self.basis[1].T) * mu_slope
        begin, chord = hodograph[:, :, :-1], np.diff(hodograph, axis=2)
        along = -(begin * chord).sum(axis=1)
        share = np.clip(along / ((chord * chord).sum(axis=1) + 1e-30), 0.0, 1.0)
        arcs = self.nodes[:-1] + share * np.diff(self.nodes)
        robots = np.repeat(np.arange(n), count)
        margins, _ = self.margins(motion, robots, arcs.ravel(), linearise=False)
        shaped = np.swapaxes(margins.reshape(2, n, count), 0, 1).copy()
        shaped[model.task.staying] = 1.0
        return HodographValues(arcs, shaped)

    def rows(self, motion: FormationMotion, values: HodographValues) -> tuple[Array, Array]:
        """Margins near active (r,) and their derivatives with respect to Z (r, n, P)."""
        model = self.model
        near = values.margins.min(axis=1) < _ACTIVE
        robots, k = np.nonzero(near)
        margins, slopes = self.margins(motion, robots, values.arcs[robots, k], linearise=True)
        jacobian = np.zeros((2, robots.size, model.task.n, model.size))
        jacobian[:, np.arange(robots.size), robots] = slopes
        return margins.ravel(), jacobian.reshape(-1, model.task.n, model.size)

    def margins(
        self, motion: FormationMotion, robots: NDArray[np.intp], s: Array, linearise: bool
    ) -> tuple[Array, Array]:
        """Margins of delta >= -limit and delta <= limit (2, r), and slopes (2, r, P)."""
        model, task = self.model, self.model.task
        local = _Local(model, motion, robots, s)
        x1, x2, x3 = local.coordinates
        mu, mu1, mu2 = local.speed
        force = x2 * mu - x1 * mu1
        turn = x3 * mu - x1 * mu2
        square = (force * force).sum(axis=0)
        cross = force[0] * turn[1] - force[1] * turn[0] - local.yaw * square
        limit = _RATE_SHARE * task.thruster_rate * mu
        gate = (_GATE * task.thrust * mu**3) ** 2
        below = limit * (square + gate)
        margins = np.stack([limit * square + cross, limit * square - cross]) / below
        if not linearise:
            return margins, np.zeros(0)
        d1, d2, d3 = local.coordinate_slopes()
        dmu, dmu1, dmu2 = local.speed_slopes()

        def product(x: Array, dx: Array, m: Array, dm: Array) -> Array:
            return np.asarray(dx * m[:, None] + x[..., None] * dm)

        dforce = product(x2, d2, mu, dmu) - product(x1, d1, mu1, dmu1)
        dturn = product(x3, d3, mu, dmu) - product(x1, d1, mu2, dmu2)
        dsquare = 2 * (force[..., None] * dforce).sum(axis=0)
        dcross = (
            force[0][:, None] * dturn[1] + turn[1][:, None] * dforce[0]
            - force[1][:, None] * dturn[0] - turn[0][:, None] * dforce[1]
            - local.yaw[:, None] * dsquare - square[:, None] * local.yaw_slope()
        )  # fmt: skip
        dlimit = (limit / mu)[:, None] * dmu
        dbelow = dlimit * (square + gate)[:, None] + limit[:, None] * (
            dsquare + (6 * gate / mu)[:, None] * dmu
        )
        dabove = dlimit * square[:, None] + limit[:, None] * dsquare
        slopes = np.stack([dabove + dcross, dabove - dcross]) - margins[..., None] * dbelow
        return margins, slopes / below[:, None]


class _Local:
    """Coordinates, their derivatives in s and the speed of some robots at an arc each."""

    def __init__(
        self, model: ReferenceMotion, motion: FormationMotion, robots: NDArray[np.intp], s: Array
    ) -> None:
        self.model, self.motion, self.robots = model, motion, robots
        self.basis = [model.values(s, d) for d in (1, 2, 3)]
        self.yaw_basis = model.yaw_values(s, 1)
        self.speed_basis = [model.speed_basis(s, d) for d in range(3)]
        position = motion.position[robots]
        self.coordinates = [np.einsum('rdm,rm->dr', position, basis) for basis in self.basis]
        self.yaw = np.einsum('rm,rm->r', motion.yaw[robots], self.yaw_basis)
        rates = motion.rates[robots]
        self.speed = [np.einsum('rb,rb->r', rates, basis) for basis in self.speed_basis]

    def coordinate_slopes(self) -> list[Array]:
        """Slopes with respect to Z of X_s, X_ss, X_sss, (2, r, P) each."""
        model, slopes = self.model, []
        for basis in self.basis:
            slope = np.zeros((2, basis.shape[0], model.size))
            for axis in range(2):
                begin = model.nb + axis * model.nf
                end = begin + model.nf
                slope[axis, :, begin:end] = basis @ model.basis.free * model.length_scale
            if model.moving_start:
                by_rate = np.einsum('rdbm,rm->drb', self.motion.position_slope[self.robots], basis)
                slope[:, :, : model.nb] = by_rate * model.time_scale
            slopes.append(slope)
        return slopes

    def speed_slopes(self) -> list[Array]:
        """Slopes with respect to Z of mu, mu_s, mu_ss, (r, P) each."""
        slopes = []
        for basis in self.speed_basis:
            slope = np.zeros((basis.shape[0], self.model.size))
            slope[:, : self.model.nb] = basis * self.model.time_scale
            slopes.append(slope)
        return slopes

    def yaw_slope(self) -> Array:
        """Slope with respect to Z of yaw_s, (r, P)."""
        model = self.model
        slope = np.zeros((self.robots.size, model.size))
        by_rate = np.einsum('rbm,rm->rb', self.motion.yaw_slope[self.robots], self.yaw_basis)
        slope[:, : model.nb] = by_rate * model.time_scale
        if model.ny:
            free = self.yaw_basis @ model.yaw_basis.free * model.yaw_scale
            first = model.nb + 2 * model.nf
            slope[:, first:] = free
        return slope
