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
Gas and margins of a formation as functions of the varied parameters, with derivatives.

In numpy, for all forms of the reference functions; `formation_compiled` is faster with some.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation_cost import GasAndThrust
from tdm_planner.problems.inverse_dynamics import clenshaw_curtis, InverseDynamics, NodeValues
from tdm_planner.problems.reference_motion import FormationMotion, ReferenceMotion
from tdm_planner.problems.separation import (
    CircleApproaches,
    CircleSeparation,
    PairApproaches,
    PairSeparation,
)

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NEAR = 0.6  # approaches within this share beyond the clearance become rows
ACTIVE_THRUST, ACTIVE_TORQUE, ACTIVE_WALL = 0.35, 0.5, 1.0


@dataclass(frozen=True, eq=False)
class FormationValues:
    """
    What is known at one Xi; margins are relative to their limits, negative if violated.

    `durations` (n,) s without coasting, `gas` (n,) m/s; `thrust`, `torque` (n, K) at the nodes,
    `walls` (n, 2, 2, W) [robot, side, axis, arc]; `inner` is what derivatives are computed from.
    """

    durations: Array
    gas: Array
    thrust: Array
    torque: Array
    walls: Array
    pairs: PairApproaches
    circles: CircleApproaches
    inner: Any

    @property
    def worst(self) -> float:
        """Return the smallest margin, 0 if all are kept."""
        margins = (self.thrust, self.torque, self.walls, self.pairs.margins, self.circles.margins)
        return min(float(margin.min(initial=0.0)) for margin in margins)


class Terms(Protocol):
    """Gas and margins at scaled varied parameters z (n, P), and their derivatives."""

    def values(self, z: Array) -> FormationValues:
        """Gas and margins at z."""

    def derivatives(
        self, values: FormationValues, weight: float, dual: Array | None
    ) -> tuple[Array, Array]:
        """
        Gradient (n, P) of `weight` times the gas, and Hessian (n, P, P) of the Lagrangian.

        `dual` (n, K), if given, holds the multipliers of the margins of thrust.
        """

    def rows(self, values: FormationValues) -> tuple[Array, Array]:
        """Margins near active (r,) and their slopes (r, n P), those of thrust first."""


@dataclass(frozen=True, eq=False)
class NodeGrid:
    """
    Where the terms of a model are evaluated, and what does not change with Xi.

    `nodes` Chebyshev nodes; common instants of pairs `interval` s apart; `segments` of arcs near
    circles.
    """

    model: ReferenceMotion
    nodes: int
    interval: float
    segments: int

    @cached_property
    def quadrature(self) -> tuple[Array, Array]:
        """Nodes (K,) and weights (K,)."""
        return clenshaw_curtis(self.nodes)

    @cached_property
    def wall_arcs(self) -> Array:
        """Arcs at which walls are looked at (W,)."""
        count = 2 * self.model.order - 1
        return np.arange(1, count + 1) / (count + 1)

    @cached_property
    def dynamics(self) -> InverseDynamics:
        """Inverse dynamics at the nodes."""
        return InverseDynamics(self.model, self.quadrature[0])

    @cached_property
    def gas(self) -> GasAndThrust:
        """Gas and limits of thrust at the nodes."""
        return GasAndThrust(self.dynamics, self.quadrature[1])

    @cached_property
    def pairs(self) -> PairSeparation:
        """Separations of all pairs that move."""
        return PairSeparation(self.model, self.interval, NEAR)

    @cached_property
    def circles(self) -> CircleSeparation:
        """Distances of robots that move from what stands still."""
        return CircleSeparation(self.model, self.segments, NEAR)


class ArrayTerms:
    """The terms on a grid, in numpy; `inner` of their values holds motion and node values."""

    def __init__(self, grid: NodeGrid) -> None:
        self.grid, self.model = grid, grid.model
        self.wall_basis = self.model.values(grid.wall_arcs)
        self.wall_clearances = self.model.task.wall_clearances()

    def values(self, z: Array) -> FormationValues:
        """Gas and margins at z."""
        grid, task, motion = self.grid, self.model.task, self.model.unpack(z)
        nodes = grid.dynamics.at(motion)
        places = motion.position @ self.wall_basis.T
        low = places - self.wall_clearances[:, :, 0, None]
        high = task.sides[:, None] - self.wall_clearances[:, :, 1, None] - places
        return FormationValues(
            durations=motion.durations,
            gas=grid.gas.gas(nodes),
            thrust=grid.gas.margins(nodes),
            torque=1.0 - np.abs(nodes.y[:, 2]) / (task.torque * nodes.mu),
            walls=np.stack([low, high], axis=1) / task.separation,
            pairs=grid.pairs.nearest(motion),
            circles=grid.circles.nearest(motion),
            inner=(motion, nodes),
        )

    def derivatives(
        self, values: FormationValues, weight: float, dual: Array | None
    ) -> tuple[Array, Array]:
        """Gradient and Hessian, see `Terms`."""
        motion, nodes = values.inner
        slopes = self.grid.dynamics.slopes(motion, nodes)
        return self.grid.gas.derivatives(nodes, slopes, weight, dual)

    def rows(self, values: FormationValues) -> tuple[Array, Array]:
        """Margins near active and their slopes, see `Terms`."""
        motion, nodes = values.inner
        numbers, rows = self._rows(values, motion, nodes)
        size = self.model.task.n * self.model.size
        return np.concatenate(numbers), np.concatenate(rows).reshape(-1, size)

    def _rows(
        self, values: FormationValues, motion: FormationMotion, nodes: NodeValues
    ) -> tuple[list[Array], list[Array]]:
        grid, model, task = self.grid, self.model, self.model.task
        y_slope = grid.dynamics.slopes(motion, nodes).y
        numbers, rows = [], []

        def add(robots: Indices, margins: Array, slopes: Array) -> None:
            row = np.zeros((robots.size, task.n, model.size))
            row[np.arange(robots.size), robots] = slopes
            numbers.append(margins)
            rows.append(row)

        i, k = np.nonzero(values.thrust < ACTIVE_THRUST)
        add(i, values.thrust[i, k], grid.gas.margin_rows(nodes, y_slope, i, k))

        i, k = np.nonzero(values.torque < ACTIVE_TORQUE)
        sign = np.sign(nodes.y[i, 2, k]) / (task.torque * nodes.mu[i, k])
        share = (1.0 - values.torque[i, k]) / nodes.mu[i, k]
        slopes = share[:, None] * grid.dynamics.mu_jacobian[k] - sign[:, None] * y_slope[i, 2, k]
        add(i, values.torque[i, k], slopes)

        i, side, axis, k = np.nonzero(values.walls < ACTIVE_WALL)
        sign = np.where(side == 0, 1.0, -1.0) / task.separation
        _, places = model.points(motion, i, grid.wall_arcs[k], at_fixed_time=False)
        add(i, values.walls[i, side, axis, k], sign[:, None] * places[np.arange(i.size), axis])

        numbers += [values.pairs.margins, values.circles.margins]
        rows += [
            grid.pairs.rows(motion, values.pairs),
            grid.circles.rows(motion, values.circles),
        ]
        return numbers, rows
