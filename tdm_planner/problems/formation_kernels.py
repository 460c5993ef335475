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
Compiled: gas and margins of a formation, and their derivatives, for all forms of the references.

Local variables are linear in the varied parameters Xi of a robot, so that what `robot_statement`
says of one node, and its derivatives, are chained with constant matrices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.slopes import with_curvature, with_slopes
from tdm_planner.problems.robot_statement import push, turn
from tdm_planner.problems.separation import (
    CircleApproaches,
    near_circles,
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

_PUSH, _TURN = 8, 6  # local variables
_push = inlined(with_slopes(push, (), local=_PUSH, at=4, robot=5))
_push_with_curvature = inlined(
    with_curvature(push, ('local',), local=_PUSH, at=4, robot=5, weights=2)
)
_turn = inlined(with_slopes(turn, (), local=_TURN, at=4, robot=3))
_turn_with_slopes = inlined(with_slopes(turn, ('local',), local=_TURN, at=4, robot=3))


class FormationTables(NamedTuple):
    """
    What does not change from one Xi to another, at K nodes.

    Of the local variables of a push those of `push_varied` vary. For push and turn: `slopes` (K W, P) and `given` (n, K W) of the local variables, `at` (K, 4)
    and `robots` (n, ...) as `robot_statement` has them. `weights` (K,) of the quadrature.
    """

    push_varied: Indices
    push_slopes: Array
    push_given: Array
    push_at: Array
    push_robots: Array
    turn_slopes: Array
    turn_given: Array
    turn_at: Array
    turn_robots: Array
    weights: Array
    separation: SeparationTables


class FormationValues(NamedTuple):
    """
    What is known at one Xi; margins are relative to their limits, negative if violated.

    `durations` (n,) s without coasting, `gas` (n,) m/s; `thrust`, `torque` (n, K) at the nodes,
    `walls` (n, 2, 2, W) [robot, side, axis, arc]; the rest is what derivatives are computed from.
    """

    durations: Array
    gas: Array
    thrust: Array
    torque: Array
    walls: Array
    pairs: PairApproaches
    circles: CircleApproaches
    pushed: Array
    turned: Array
    paths: Paths

    @property
    def worst(self) -> float:
        """Return the smallest margin, 0 if all are kept."""
        margins = (self.thrust, self.torque, self.walls, self.pairs.margins, self.circles.margins)
        return min(float(margin.min(initial=0.0)) for margin in margins)


@compiled
def evaluate(t: FormationTables, xi: Array) -> FormationValues:
    """Gas and margins at the varied parameters xi (n, P), not scaled."""
    n, count = xi.shape[0], t.weights.size
    pushed = (xi @ t.push_slopes.T + t.push_given).reshape(n, count, _PUSH)
    turned = (xi @ t.turn_slopes.T + t.turn_given).reshape(n, count, _TURN)
    gas, thrust, torque = np.zeros(n), np.empty((n, count)), np.empty((n, count))
    for i in range(n):
        for k in range(count):
            used, thrust[i, k] = _push(pushed[i, k], t.push_at[k], t.push_robots[i])
            gas[i] += t.weights[k] * used
            (torque[i, k],) = _turn(turned[i, k], t.turn_at[k], t.turn_robots[i])
    at = paths(t.separation, xi)
    durations = at.times.sum(axis=1)
    return FormationValues(
        durations, gas, thrust, torque, walls(t.separation, at.ends),
        near_pairs(t.separation, at), near_circles(t.separation, at), pushed, turned, at,
    )  # fmt: skip


@compiled
def linearise(
    t: FormationTables, values: FormationValues, weight: float, dual: Array
) -> tuple[Array, Array, Array, Array]:
    """
    Derivatives by xi of gas and margins.

    Gradient (n, P) of `weight` times the gas; Hessian (n, P, P) of that less `dual` (n, K) times
    the margins of thrust; margins near active (r,), those of thrust first, and slopes (r, n, P).
    """
    n, count, size = values.durations.size, t.weights.size, t.push_slopes.shape[1]
    most = values.pairs.pair.size + values.circles.robot.size
    most += np.sum(values.thrust < ACTIVE_THRUST) + np.sum(values.torque < ACTIVE_TORQUE)
    most += np.sum(values.walls < ACTIVE_WALL)
    margins, rows, r = np.empty(most), np.zeros((most, n, size)), 0
    gradient, hessian = np.zeros((n, size)), np.empty((n, size, size))
    result, weights = np.empty(2 + 2 * _PUSH + _PUSH**2), np.empty(2)
    slopes = result[2 : 2 + 2 * _PUSH].reshape(_PUSH, 2)
    curvature = result[2 + 2 * _PUSH :].reshape(_PUSH, _PUSH)
    bent = np.zeros((count * _PUSH, size))
    for i in range(n):
        for k in range(count):
            weights[0], weights[1] = weight * t.weights[k], -dual[i, k]
            _push_with_curvature(
                values.pushed[i, k], t.push_at[k], t.push_robots[i], weights, result
            )
            first = k * _PUSH
            active = values.thrust[i, k] < ACTIVE_THRUST
            for j in t.push_varied:
                local = t.push_slopes[first + j]
                for p in range(size):
                    gradient[i, p] += weights[0] * slopes[j, 0] * local[p]
                    bent[first + j, p] = 0.0
                for other in t.push_varied:
                    if curvature[j, other] != 0.0:
                        for p in range(size):
                            by_other = t.push_slopes[first + other, p]
                            bent[first + j, p] += curvature[j, other] * by_other
                if active:
                    for p in range(size):
                        rows[r, i, p] += slopes[j, 1] * local[p]
            if active:
                margins[r] = values.thrust[i, k]
                r += 1
        hessian[i] = t.push_slopes.T @ bent
    for i in range(n):
        for k in range(count):
            if values.torque[i, k] < ACTIVE_TORQUE:
                found = _turn_with_slopes(values.turned[i, k], t.turn_at[k], t.turn_robots[i])
                for j in range(_TURN):
                    for p in range(size):
                        rows[r, i, p] += found[1 + j] * t.turn_slopes[k * _TURN + j, p]
                margins[r] = values.torque[i, k]
                r += 1
    separation_rows(
        t.separation, values.paths, values.walls, ACTIVE_WALL, values.pairs, values.circles,
        margins[r:], rows[r:],
    )  # fmt: skip
    return gradient, hessian, margins, rows
