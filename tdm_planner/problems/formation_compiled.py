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

"""The terms of a formation by compiled kernels: the numbers of `ArrayTerms`, many times faster."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.problems.formation_cost import GAS_SMOOTHING, THRUST_SHARE
from tdm_planner.problems.formation_kernels import evaluate, FormationTables, KernelValues
from tdm_planner.problems.formation_slopes import derivatives, rows
from tdm_planner.problems.formation_terms import (
    ACTIVE_THRUST,
    ACTIVE_TORQUE,
    ACTIVE_WALL,
    ArrayTerms,
    FormationValues,
    NEAR,
    NodeGrid,
    Terms,
)
from tdm_planner.problems.inverse_dynamics import clenshaw_curtis
from tdm_planner.problems.reference_motion import end_derivatives, ReferenceMotion
from tdm_planner.problems.separation import CircleApproaches, PairApproaches

Array = NDArray[np.float64]


def terms_on(grid: NodeGrid) -> Terms:
    """Return the terms on a grid, compiled where the form of the reference functions allows."""
    if grid.model.degree == 0:
        return CompiledTerms(grid)
    return ArrayTerms(grid)


class _Basis(NamedTuple):
    """Tables that depend on the form of the reference functions and the grid alone."""

    taylor: Array
    bend: Array
    turn: Array
    weights: Array
    wall_places: Array
    circle_places: Array


@lru_cache(maxsize=32)
def _basis(order: int, yaw_order: int, vary_ends: bool, nodes: int, segments: int) -> _Basis:
    position = end_derivatives(order, vary_ends).basis
    s, weights = clenshaw_curtis(nodes)
    walls = 2 * order - 1
    return _Basis(
        taylor=np.stack([position.about_start, position.about_end]),
        bend=position.values(s, 2),
        turn=end_derivatives(yaw_order, False).basis.values(s, 2),
        weights=weights,
        wall_places=position.values(np.arange(1, walls + 1) / (walls + 1)),
        circle_places=position.values(np.linspace(0.0, 1.0, segments + 1)),
    )


def _given(model: ReferenceMotion) -> tuple[Array, Array]:
    """Powers of T in the end derivatives of position (3, n, 2, m) and yaw (3, n, my)."""
    task = model.task
    given = np.zeros((3, task.n, 2, model.order + 1))
    given[0, ..., 0], given[0, ..., model.basis.goal] = task.departure, task.goal
    given[1, ..., 1] = task.velocity
    if not model.vary_ends:
        given[2, ..., 2] = task.acceleration
    turning = np.zeros((3, task.n, model.yaw_order + 1))
    turning[0, :, 0], turning[0, :, model.yaw_basis.goal] = task.departure_yaw, task.goal_yaw
    turning[1, :, 1], turning[2, :, 2] = task.yaw_rate, task.yaw_acceleration
    return given, turning


def _tables(grid: NodeGrid) -> FormationTables:
    model, task = grid.model, grid.model.task
    basis = _basis(
        model.order, model.yaw_order, model.vary_ends, grid.nodes, grid.segments
    )._asdict()
    given, turning = _given(model)
    shapes = model.basis.free * model.length_scale
    moving = np.flatnonzero(~task.staying)
    first, second = np.triu_indices(moving.size, 1)
    pairs = np.stack([moving[first], moving[second]], axis=1)
    centres, clearances = task.circles()
    return FormationTables(
        given=given,
        turning=turning,
        shapes=shapes,
        yaw_shapes=model.yaw_basis.free * model.yaw_scale,
        bent_shapes=basis['bend'] @ shapes,
        wall_clearances=np.ascontiguousarray(task.wall_clearances()),
        sides=task.sides,
        pairs=np.ascontiguousarray(pairs),
        pair_clearances=task.pair_clearances(pairs[:, 0], pairs[:, 1]),
        moving=moving,
        centres=np.ascontiguousarray(centres),
        circle_clearances=np.ascontiguousarray(clearances),
        coast=np.ascontiguousarray(task.coast),
        velocity=np.ascontiguousarray(task.velocity),
        time_scale=model.time_scale,
        rest=GAS_SMOOTHING * task.thrust,
        limit=THRUST_SHARE * task.thrust,
        torque=float(task.torque),
        separation=float(task.separation),
        interval=grid.interval,
        near=NEAR,
        **basis,
    )


def compile_terms(model: ReferenceMotion) -> None:
    """Compile the kernels or load them from the disk."""
    terms = CompiledTerms(NodeGrid(model, 9, model.time_scale, 4))
    values = terms.values(np.ones((model.task.n, model.size)))
    terms.derivatives(values, 1.0, None)
    terms.rows(values)


class CompiledTerms:
    """The terms on a grid; `inner` of their values holds those of the kernels."""

    def __init__(self, grid: NodeGrid) -> None:
        self.tables, self.size = _tables(grid), grid.model.size

    def values(self, z: Array) -> FormationValues:
        """Gas and margins at z."""
        found = evaluate(self.tables, z)
        return FormationValues(
            durations=found.durations,
            gas=found.gas,
            thrust=found.thrust,
            torque=found.torque,
            walls=found.walls,
            pairs=PairApproaches(
                found.pair, found.pair_times, found.pair_margins, found.pair_units
            ),
            circles=CircleApproaches(
                found.robot,
                found.circle,
                found.circle_arcs,
                found.circle_margins,
                found.circle_units,
            ),
            inner=found,
        )

    def derivatives(
        self, values: FormationValues, weight: float, dual: Array | None
    ) -> tuple[Array, Array]:
        """Gradient and Hessian, see `Terms`."""
        if dual is None:
            dual = np.zeros(values.thrust.shape)
        gradient, hessian = derivatives(self.tables, values.inner, weight, dual, self.size)
        return gradient, hessian

    def rows(self, values: FormationValues) -> tuple[Array, Array]:
        """Margins near active and their slopes, see `Terms`."""
        inner: KernelValues = values.inner
        active = ACTIVE_THRUST, ACTIVE_TORQUE, ACTIVE_WALL
        margins, slopes = rows(self.tables, inner, *active, self.size)
        return margins, slopes
