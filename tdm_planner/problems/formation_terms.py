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

"""Gas and margins of a formation as functions of the varied parameters, with derivatives."""

from __future__ import annotations

from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.arc_nodes import chebyshev_nodes, quadrature_weights
from tdm_planner.problems.formation_kernels import (
    evaluate,
    FormationTables,
    FormationValues,
    linearise,
)
from tdm_planner.problems.reference_motion import (
    end_derivatives,
    LocalVariables,
    MotionForm,
    ReferenceMotion,
)
from tdm_planner.problems.separation import PairApproaches, SeparationTables

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class FormationTerms:
    """
    The terms of all robots on `nodes` Chebyshev nodes, see `formation_kernels`.

    Common instants of pairs are `interval` s apart, arcs are looked at near circles in `segments`.
    """

    def __init__(self, model: ReferenceMotion, nodes: int, interval: float, segments: int) -> None:
        self.nodes, self._scales = nodes, model.scales
        grid = _grid(model.form, nodes, segments)
        ends, path, angle = departures(model)
        self._pushed = np.tensordot(ends, grid.push.ends, (1, 2))
        self._turned = np.tensordot(ends, grid.turn.ends, (1, 2))
        task, every = model.task, np.ones((model.task.n, 1))
        self._tables = FormationTables(
            push_varied=np.flatnonzero(grid.push.slopes.any(axis=(0, 2))),
            push_slopes=grid.push.slopes.reshape(-1, model.size),
            push_at=grid.push.at,
            push_robots=np.concatenate([path, task.thrust * every], axis=1),
            turn_slopes=grid.turn.slopes.reshape(-1, model.size),
            turn_at=grid.turn.at,
            turn_robots=np.concatenate([angle, task.torque * every], axis=1),
            weights=grid.weights,
            separation=_separation(model, grid, interval),
        )

    def values(self, z: Array) -> FormationValues:
        """Gas and margins at the scaled varied parameters z (n, P)."""
        xi, t = z * self._scales, self._tables
        pushed = (xi @ t.push_slopes.T).reshape(self._pushed.shape) + self._pushed
        turned = (xi @ t.turn_slopes.T).reshape(self._turned.shape) + self._turned
        return evaluate(t, xi, pushed, turned)

    def linearise(
        self, values: FormationValues, weight: float, dual: Array
    ) -> tuple[Array, Array, Array, Array]:
        """
        Differentiate by z.

        Gradient (n, P) of `weight` times the gas, Hessian (n, P, P) of that less `dual` (n, K)
        times the margins of thrust, margins near active (r,) and their slopes (r, n P).
        """
        gradient, hessian, margins, rows = linearise(
            self._tables, values, weight, dual, values.near
        )
        scales = self._scales
        rows *= scales
        return (
            gradient * scales, hessian * (scales[:, None] * scales), margins,
            rows.reshape(margins.size, gradient.size),
        )  # fmt: skip

    def robots(self, near: PairApproaches) -> tuple[Indices, Indices]:
        """Return both robots of every approach."""
        first, second = self._tables.separation.pairs[near.pair].T
        return first, second


def departures(model: ReferenceMotion) -> tuple[Array, Array, Array]:
    """
    Return boundary values of the robots as the functions of `robot_statement` take them.

    Departure and goal of x, y and yaw (n, 6); velocity and acceleration at the start of x and y
    (n, 4), and of yaw (n, 2).
    """
    task = model.task
    places = np.stack([task.departure, task.goal], axis=2).reshape(task.n, 4)
    path = np.stack([task.velocity, task.acceleration], axis=2).reshape(task.n, 4)
    angle = np.stack([task.yaw_rate, task.yaw_acceleration], axis=1)
    return np.column_stack([places, task.departure_yaw, task.goal_yaw]), path, angle


def compile_terms(model: ReferenceMotion) -> None:
    """Compile the kernels or load them from the disk."""
    terms = FormationTerms(model, 9, model.time_scale, 4)
    values = terms.values(np.ones((model.task.n, model.size)))
    terms.linearise(values, 1.0, np.zeros(values.thrust.shape))


class _Grid(NamedTuple):
    """What depends on the form of the references and the nodes alone."""

    weights: Array
    push: LocalVariables
    turn: LocalVariables
    taylor: Array
    passing: Array
    wall_places: Array
    circle_places: Array


@lru_cache(maxsize=32)
def _grid(form: MotionForm, nodes: int, segments: int) -> _Grid:
    s = chebyshev_nodes(nodes)
    basis, arcs = end_derivatives(form.order, form.vary_ends).basis, 2 * form.order - 1
    return _Grid(
        weights=quadrature_weights(s),
        push=LocalVariables.of(form, s, speed=2, position=2),
        turn=LocalVariables.of(form, s, speed=2, yaw=2),
        taylor=np.stack([basis.about_start, basis.about_end]),
        passing=_passing(form.degree),
        wall_places=basis.values(np.arange(1, arcs + 1) / (arcs + 1)),
        circle_places=basis.values(np.linspace(0.0, 1.0, segments + 1)),
    )


def _separation(model: ReferenceMotion, grid: _Grid, interval: float) -> SeparationTables:
    task = model.task
    moving = np.flatnonzero(~task.staying)
    first, second = np.triu_indices(moving.size, 1)
    pairs = np.stack([moving[first], moving[second]], axis=1)
    centres, clearances = task.circles()
    fixed = np.zeros((task.n, 2, model.order + 1))
    fixed[..., 0], fixed[..., model.basis.goal] = task.departure, task.goal
    return SeparationTables(
        shapes=model.basis.free,
        taylor=grid.taylor,
        passing=grid.passing,
        slope=model.departing[1],
        wall_places=grid.wall_places,
        circle_places=grid.circle_places,
        fixed=fixed,
        velocity=np.ascontiguousarray(task.velocity),
        acceleration=np.ascontiguousarray(task.acceleration),
        given=0.0 if model.vary_ends else 1.0,
        coast=np.ascontiguousarray(task.coast),
        wall_clearances=np.ascontiguousarray(task.wall_clearances()),
        sides=task.sides,
        separation=float(task.separation),
        pairs=pairs,
        pair_clearances=task.pair_clearances(pairs[:, 0], pairs[:, 1]),
        moving=moving,
        centres=np.ascontiguousarray(centres),
        circle_clearances=np.ascontiguousarray(clearances),
        interval=interval,
    )


def _passing(degree: int) -> Array:
    """Powers of s (q + 1, q + 2) in the integrals of Bernstein's polynomials."""
    powers = np.zeros((degree + 1, degree + 2))
    for k in range(degree + 1):
        for j in range(degree - k + 1):
            power = k + j + 1
            choices = math.comb(degree, k) * math.comb(degree - k, j)
            powers[k, power] = (-1) ** j * choices / power
    return powers
