# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Compiled: gas and margins of a formation, and their derivatives, for all forms of the references.

Local variables are linear in the varied parameters Xi of a robot, so that what `robot_statement`
says of one node, and its derivatives, are chained with constant matrices.
"""

from __future__ import annotations

from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.direct_method.virtual_arc import chebyshev_nodes, quadrature_weights
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.slopes import with_curvature, with_slopes
from tdm_planner.problems.reference_motion import (
    end_derivatives,
    LocalVariables,
    MotionForm,
    ReferenceMotion,
)
from tdm_planner.problems.robot_statement import push, turn
from tdm_planner.problems.separation import (
    near_pairs,
    PairApproaches,
    Paths,
    paths,
    separation_rows,
    SeparationTables,
    walls,
)

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

ACTIVE_THRUST, ACTIVE_TORQUE, ACTIVE_WALL = 0.35, 0.5, 1.0
_INSTANTS = 32  # in a typical time, at which pairs are looked at

PUSH, TURN = 8, 6  # local variables
_push = inlined(with_slopes(push, (), local=PUSH, at=4, robot=5))
_push_with_curvature = inlined(
    with_curvature(push, ('local',), local=PUSH, at=4, robot=5, weights=2)
)
_SLOPES = 2  # where they begin among the results
_CURVATURE = _SLOPES + 2 * PUSH
_RESULT = _CURVATURE + PUSH**2
_turn = inlined(with_slopes(turn, (), local=TURN, at=4, robot=3))
_turn_with_slopes = inlined(with_slopes(turn, ('local',), local=TURN, at=4, robot=3))


class FormationTables(NamedTuple):
    """
    What does not change from one Xi to another, at K nodes.

    For push and turn: `slopes` (K W, P) of the local variables and their values where Xi is zero,
    `fixed` (n, K, W); `at` (K, 4) and `robots` (n, ...) as `robot_statement` has them; of a push's
    local variables, those of `push_varied` depend on Xi. `weights` (K,) of the quadrature.
    """

    push_varied: Indices
    push_slopes: Array
    push_fixed: Array
    push_at: Array
    push_robots: Array
    turn_slopes: Array
    turn_fixed: Array
    turn_at: Array
    turn_robots: Array
    weights: Array
    separation: SeparationTables


class FormationValues(NamedTuple):
    """
    What is known at one Xi; margins are relative to their limits, negative if violated.

    `durations` (n,) s without coasting, `gas` (n,) m/s; `thrust`, `torque` (n, K) at the nodes,
    `walls` (n, 2, 2, W) [robot, side, axis, arc]; derivatives are computed from the rest.
    """

    durations: Array
    gas: Array
    thrust: Array
    torque: Array
    walls: Array
    pairs: PairApproaches
    pushed: Array
    turned: Array
    paths: Paths

    @property
    def near(self) -> int:
        """Count the margins near active."""
        near = np.count_nonzero(self.thrust < ACTIVE_THRUST)
        near += np.count_nonzero(self.torque < ACTIVE_TORQUE)
        near += np.count_nonzero(self.walls < ACTIVE_WALL)
        return int(near + self.pairs.pair.size)

    @property
    def worst(self) -> float:
        """Return the smallest margin, 0 if all are kept."""
        margins = (self.thrust, self.torque, self.walls, self.pairs.margins)
        return min(float(margin.min(initial=0.0)) for margin in margins)


@compiled
def evaluate(t: FormationTables, xi: Array, pushed: Array, turned: Array) -> FormationValues:
    """Gas and margins at the varied parameters xi (n, P), not scaled; locals (n, K, W)."""
    n, count = xi.shape[0], t.weights.size
    gas, thrust, torque = np.zeros(n), np.empty((n, count)), np.empty((n, count))
    for i in range(n):
        for k in range(count):
            used, thrust[i, k] = _push(pushed[i, k], t.push_at[k], t.push_robots[i])
            gas[i] += t.weights[k] * used
            (torque[i, k],) = _turn(turned[i, k], t.turn_at[k], t.turn_robots[i])
    at = paths(t.separation, xi)
    return FormationValues(
        at.durations, gas, thrust, torque, walls(t.separation, at.ends),
        near_pairs(t.separation, at), pushed, turned, at,
    )  # fmt: skip


@compiled
def linearise(
    t: FormationTables, values: FormationValues, weight: float, dual: Array, most: int
) -> tuple[Array, Array, Array, Array]:
    """
    Differentiate gas and margins by xi.

    Gradient (n, P) of `weight` times the gas; Hessian (n, P, P) of that less `dual` (n, K) times
    the margins of thrust; the `most` margins near active (r,), those of thrust first, and their
    slopes (r, n, P).
    """
    n, count, size = values.durations.size, t.weights.size, t.push_slopes.shape[1]
    margins, rows, r = np.empty(most), np.zeros((most, n, size)), 0
    gradient, hessian = np.zeros((n, size)), np.zeros((n, size, size))
    found, weights, bent = np.empty(_RESULT), np.empty(2), np.empty(size)
    for i in range(n):
        for k in range(count):
            local, first = values.pushed[i, k], k * PUSH
            weights[0], weights[1] = weight * t.weights[k], -dual[i, k]
            _push_with_curvature(local, t.push_at[k], t.push_robots[i], weights, found)
            active = values.thrust[i, k] < ACTIVE_THRUST
            for j in t.push_varied:
                bent[:] = 0.0
                for other in t.push_varied:
                    curvature = found[_CURVATURE + PUSH * j + other]
                    if curvature != 0.0:
                        for p in range(size):
                            bent[p] += curvature * t.push_slopes[first + other, p]
                gas, thrust = weights[0] * found[_SLOPES + 2 * j], found[_SLOPES + 2 * j + 1]
                for p in range(size):
                    slope = t.push_slopes[first + j, p]
                    if slope != 0.0:
                        gradient[i, p] += gas * slope
                        for q in range(size):
                            hessian[i, p, q] += slope * bent[q]
                        if active:
                            rows[r, i, p] += thrust * slope
            if active:
                margins[r] = values.thrust[i, k]
                r += 1
    for i in range(n):
        for k in range(count):
            if values.torque[i, k] < ACTIVE_TORQUE:
                local = values.turned[i, k]
                slopes = _turn_with_slopes(local, t.turn_at[k], t.turn_robots[i])[1:]
                for j, slope in enumerate(slopes):
                    for p in range(size):
                        rows[r, i, p] += slope * t.turn_slopes[k * TURN + j, p]
                margins[r] = values.torque[i, k]
                r += 1
    separation_rows(
        t.separation, values.paths, values.walls, ACTIVE_WALL, values.pairs, margins[r:], rows[r:]
    )
    return gradient, hessian, margins, rows


class _Grid(NamedTuple):
    """What depends on the form of the references alone."""

    weights: Array
    push: LocalVariables
    turn: LocalVariables
    taylor: Array
    passing: Array
    wall_places: Array


@lru_cache(maxsize=32)
def _grid(form: MotionForm) -> _Grid:
    s = chebyshev_nodes(form.points)
    basis, arcs = end_derivatives(form.order, form.vary_ends).basis, 2 * form.order - 1
    return _Grid(
        weights=quadrature_weights(s),
        push=LocalVariables.of(form, s, speed=2, position=2),
        turn=LocalVariables.of(form, s, speed=2, yaw=2),
        taylor=np.stack([basis.about_start, basis.about_end]),
        passing=_passing(form.degree),
        wall_places=basis.values(np.arange(1, arcs + 1) / (arcs + 1)),
    )


def tabulated(model: ReferenceMotion) -> FormationTables:
    """Return the tables of a manoeuvre."""
    task, grid, every = model.task, _grid(model.form), np.ones((model.task.n, 1))
    places = np.stack([task.departure, task.goal], axis=2).reshape(task.n, 4)
    ends = np.column_stack([places, task.departure_yaw, task.goal_yaw])
    path = np.stack([task.velocity, task.acceleration], axis=2).reshape(task.n, 4)
    angle = np.stack([task.yaw_rate, task.yaw_acceleration], axis=1)
    return FormationTables(
        push_varied=np.flatnonzero(grid.push.slopes.any(axis=(0, 2))),
        push_slopes=grid.push.slopes.reshape(-1, model.size),
        push_fixed=np.tensordot(ends, grid.push.ends, (1, 2)),
        push_at=grid.push.at,
        push_robots=np.concatenate([path, task.thrust * every], axis=1),
        turn_slopes=grid.turn.slopes.reshape(-1, model.size),
        turn_fixed=np.tensordot(ends, grid.turn.ends, (1, 2)),
        turn_at=grid.turn.at,
        turn_robots=np.concatenate([angle, task.torque * every], axis=1),
        weights=grid.weights,
        separation=_separation(model, grid),
    )


def _separation(model: ReferenceMotion, grid: _Grid) -> SeparationTables:
    task = model.task
    moving = np.flatnonzero(~task.staying)
    first, second = np.triu_indices(moving.size, 1)
    one, other = moving[first], moving[second]
    centres, clearances = task.circles()
    beside = np.repeat(moving, len(centres)), np.tile(np.arange(len(centres)), moving.size)
    fixed = np.zeros((task.n, 2, model.order + 1))
    fixed[..., 0], fixed[..., model.basis.goal] = task.departure, task.goal
    return SeparationTables(
        shapes=model.basis.free,
        taylor=grid.taylor,
        passing=grid.passing,
        slope=model.departing[1],
        wall_places=grid.wall_places,
        fixed=fixed,
        velocity=np.ascontiguousarray(task.velocity),
        acceleration=np.ascontiguousarray(task.acceleration),
        given=0.0 if model.vary_ends else 1.0,
        coast=np.ascontiguousarray(task.coast),
        wall_clearances=np.ascontiguousarray(task.wall_clearances()),
        sides=task.sides,
        separation=float(task.separation),
        pairs=np.column_stack([np.append(one, beside[0]), np.append(other, beside[1] + task.n)]),
        pair_clearances=np.append(task.pair_clearances(one, other), clearances[beside]),
        centres=np.ascontiguousarray(centres),
        interval=1.5 * model.time_scale / _INSTANTS,
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
