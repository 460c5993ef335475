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

The rate is worst where the hodograph N(s) passes near the origin: rows are taken at the nearest
approach of every chord of the hodograph. What they say there: `robot_statement.flip`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.slopes import with_slopes
from tdm_planner.problems.formation_terms import departures
from tdm_planner.problems.reference_motion import FormationMotion, LocalVariables, ReferenceMotion
from tdm_planner.problems.robot_statement import flip, hodograph

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_ACTIVE = 0.7
_LOCAL = 12  # local variables


@dataclass(frozen=True)
class HodographValues:
    """Chords' nearest approaches: arcs (n, K - 1), and margins of both limits (n, 2, K - 1)."""

    arcs: Array
    margins: Array


class ThrusterRows:
    """Rows for the chords between the arcs `nodes` (K,)."""

    def __init__(self, model: ReferenceMotion, nodes: Array) -> None:
        self.model, self.nodes = model, nodes
        task, every = model.task, np.ones((model.task.n, 1))
        self._ends, path, angle = departures(model)
        limits = task.thruster_rate * every, task.thrust * every
        self._robots = np.concatenate([path, angle, *limits], axis=1)
        self._speed = [model.speed_basis(nodes, d) for d in range(2)]
        self._path = [model.values(nodes, d) for d in (1, 2)]

    def values(self, motion: FormationMotion, z: Array) -> HodographValues:
        """Margins at the nearest approaches of all robots that move, at z (n, P)."""
        task, count = self.model.task, self.nodes.size - 1
        speed = [(motion.rates @ basis.T)[:, None] for basis in self._speed]
        points = hodograph(*speed, *(motion.position @ basis.T for basis in self._path))
        begin, chord = points[:, :, :-1], np.diff(points, axis=2)
        along = -(begin * chord).sum(axis=1)
        share = np.clip(along / ((chord * chord).sum(axis=1) + 1e-30), 0.0, 1.0)
        arcs = self.nodes[:-1] + share * np.diff(self.nodes)
        _, local = self._local(z, np.repeat(np.arange(task.n), count), arcs.ravel())
        margins = np.stack(flip(*local)).reshape(2, task.n, count)
        shaped = np.swapaxes(margins, 0, 1).copy()
        shaped[task.staying] = 1.0
        return HodographValues(arcs, shaped)

    def rows(self, z: Array, values: HodographValues) -> tuple[Array, Array]:
        """Margins near active (r,) and their derivatives with respect to z (r, n, P)."""
        robots, k = np.nonzero(values.margins.min(axis=1) < _ACTIVE)
        margins, slopes = self.margins(z, robots, values.arcs[robots, k])
        jacobian = np.zeros((2, robots.size, *z.shape))
        jacobian[:, np.arange(robots.size), robots] = slopes
        return margins.ravel(), jacobian.reshape(-1, *z.shape)

    def margins(self, z: Array, robots: Indices, s: Array) -> tuple[Array, Array]:
        """Margins (2, r) of `robots` (r,) at the arcs s (r,), and slopes (2, r, P)."""
        slopes, local = self._local(z, robots, s)
        found = np.stack(np.broadcast_arrays(*_flip(*local)))
        by_local = found[2:].reshape(_LOCAL, 2, s.size)
        return found[:2], np.swapaxes(by_local.T @ slopes, 0, 1)

    def _local(self, z: Array, robots: Indices, s: Array) -> tuple[Array, list[Any]]:
        """Slopes (r, W, P) of the local variables, and the arguments of `flip`, (..., r) each."""
        at = LocalVariables.of(self.model.form, s, 3, 3, 1)
        slopes = at.slopes * self.model.scales
        local = slopes @ z[robots, :, None] + at.ends @ self._ends[robots, :, None]
        return slopes, [local[..., 0].T, at.at.T, self._robots[robots].T]


_flip = with_slopes(flip, ('local',), local=_LOCAL, at=8, robot=8)
