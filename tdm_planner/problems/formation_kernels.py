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
Compiled: motions, gas, margins and separations of a formation at tau = t.

The same numbers as `FormationTerms` gives, in loops over robots, nodes and instants for speed
factors of degree 0, where mu is the time T that a manoeuvre takes: every end derivative is
given[0] + T given[1] + T^2 given[2] plus the shapes that are varied, X'' = X_ss / T^2, and mu's
slopes vanish. Their derivatives: `formation_slopes`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOST_INSTANTS = 4000


class FormationTables(NamedTuple):
    """
    What does not change from one Xi to another; m, my: end derivatives of one coordinate.

    `given` (3, n, 2, m) and `turning` (3, n, my): powers of T in the end derivatives; `shapes`
    (m, nf), `yaw_shapes` (my, ny): end derivatives of the varied shapes, scaled; `taylor`
    (2, m, m): expansions about s = 0 and 1. `bend` (K, m), `turn` (K, my) and `bent_shapes`
    (K, nf): second derivatives at the nodes, whose quadrature weights are `weights` (K,);
    `wall_places` (W, m) and `circle_places` (S, m): values at the arcs for walls and circles.
    Pairs are `pairs` (p, 2) of robots with clearances (p,); circles `centres` (c, 2) with
    clearances (n, c) of the robots `moving` (r,).
    """

    given: Array
    turning: Array
    shapes: Array
    yaw_shapes: Array
    taylor: Array
    bend: Array
    bent_shapes: Array
    turn: Array
    weights: Array
    wall_places: Array
    wall_clearances: Array
    sides: Array
    pairs: Indices
    pair_clearances: Array
    moving: Indices
    centres: Array
    circle_clearances: Array
    circle_places: Array
    coast: Array
    velocity: Array
    time_scale: float
    rest: float
    limit: float
    torque: float
    separation: float
    interval: float
    near: float


class KernelValues(NamedTuple):
    """
    What `evaluate` finds.

    `durations` T (n,); `ends` (n, 2, m); `second` (n, 3, K) X_ss of x, y, yaw; `gas` (n,);
    margins `thrust`, `torque` (n, K), `walls` (n, 2, 2, W) [robot, side, axis, arc]. Approaches
    of pairs: pair, instant, margin, unit vector (r, ...); of circles: robot, circle, arc, margin,
    unit vector.
    """

    durations: Array
    ends: Array
    second: Array
    gas: Array
    thrust: Array
    torque: Array
    walls: Array
    pair: Indices
    pair_times: Array
    pair_margins: Array
    pair_units: Array
    robot: Indices
    circle: Indices
    circle_arcs: Array
    circle_margins: Array
    circle_units: Array


@compiled
def evaluate(t: FormationTables, z: Array) -> KernelValues:
    """Motions and margins at the scaled varied parameters z (n, P)."""
    n, nf = z.shape[0], t.shapes.shape[1]
    durations = z[:, 0] * t.time_scale
    m, my = t.shapes.shape[0], t.yaw_shapes.shape[0]
    ends, turns = np.empty((n, 2, m)), np.empty((n, my))
    for i in range(n):
        time = durations[i]
        for axis in range(2):
            first = 1 + axis * nf
            for j in range(m):
                x = t.given[0, i, axis, j] + time * t.given[1, i, axis, j]
                x += time * time * t.given[2, i, axis, j]
                for q in range(nf):
                    x += t.shapes[j, q] * z[i, first + q]
                ends[i, axis, j] = x
        for j in range(my):
            x = t.turning[0, i, j] + time * t.turning[1, i, j]
            x += time * time * t.turning[2, i, j]
            for q in range(t.yaw_shapes.shape[1]):
                x += t.yaw_shapes[j, q] * z[i, 1 + 2 * nf + q]
            turns[i, j] = x
    second, gas, thrust, torque = _at_nodes(t, durations, ends, turns)
    walls = _walls(t, ends)
    pair, pair_times, pair_margins, pair_units = _near_pairs(t, durations, ends)
    robot, circle, arcs, circle_margins, circle_units = _near_circles(t, ends)
    return KernelValues(
        durations, ends, second, gas, thrust, torque, walls, pair, pair_times, pair_margins,
        pair_units, robot, circle, arcs, circle_margins, circle_units,
    )  # fmt: skip


@compiled
def _at_nodes(
    t: FormationTables, durations: Array, ends: Array, turns: Array
) -> tuple[Array, Array, Array, Array]:
    """X_ss (n, 3, K), gas (n,), margins of thrust and torque (n, K)."""
    n, count = durations.size, t.weights.size
    second, gas = np.empty((n, 3, count)), np.zeros(n)
    thrust, torque = np.empty((n, count)), np.empty((n, count))
    for i in range(n):
        mu = durations[i]
        for k in range(count):
            x, y, yaw = 0.0, 0.0, 0.0
            for j in range(ends.shape[2]):
                x += t.bend[k, j] * ends[i, 0, j]
                y += t.bend[k, j] * ends[i, 1, j]
            for j in range(turns.shape[1]):
                yaw += t.turn[k, j] * turns[i, j]
            second[i, 0, k], second[i, 1, k], second[i, 2, k] = x, y, yaw
            force = math.hypot(x, y) / mu
            gas[i] += t.weights[k] * math.sqrt(force**2 + (t.rest * mu) ** 2)
            thrust[i, k] = 1.0 - force / (t.limit * mu)
            torque[i, k] = 1.0 - abs(yaw / mu) / (t.torque * mu)
    return second, gas, thrust, torque


@compiled
def _walls(t: FormationTables, ends: Array) -> Array:
    n, count = ends.shape[0], t.wall_places.shape[0]
    walls = np.empty((n, 2, 2, count))
    for i in range(n):
        for axis in range(2):
            for k in range(count):
                place = 0.0
                for j in range(ends.shape[2]):
                    place += t.wall_places[k, j] * ends[i, axis, j]
                low = place - t.wall_clearances[i, axis, 0]
                high = t.sides[axis] - t.wall_clearances[i, axis, 1] - place
                walls[i, 0, axis, k] = low / t.separation
                walls[i, 1, axis, k] = high / t.separation
    return walls


@compiled
def taylor(t: FormationTables, ends: Array) -> Array:
    """Taylor coefficients (2, n, 2, m) about both ends of the arc."""
    n, m = ends.shape[0], ends.shape[2]
    found = np.zeros((2, n, 2, m))
    for side in range(2):
        for i in range(n):
            for axis in range(2):
                for k in range(m):
                    x = 0.0
                    for j in range(m):
                        x += t.taylor[side, k, j] * ends[i, axis, j]
                    found[side, i, axis, k] = x
    return found


@compiled
def polynomial(coefficients: Array, u: float) -> float:
    """Value at u of the polynomial with Taylor coefficients (m,)."""
    value = 0.0
    for k in range(coefficients.size - 1, -1, -1):
        value = value * u + coefficients[k]
    return value


@compiled
def _position(
    t: FormationTables, expansions: Array, duration: float, robot: int, time: float
) -> tuple[float, float]:
    """Where a robot is at an instant: coasting, on its way, or parked."""
    since = time - t.coast[robot]
    s = min(max(since / duration, 0.0), 1.0)
    side, u = (0, s) if s <= 0.5 else (1, s - 1.0)
    early = min(since, 0.0)
    return (
        polynomial(expansions[side, robot, 0], u) + t.velocity[robot, 0] * early,
        polynomial(expansions[side, robot, 1], u) + t.velocity[robot, 1] * early,
    )


@compiled
def _nearest(begin_x: float, begin_y: float, end_x: float, end_y: float) -> tuple[float, float]:
    """Share of the chord at which it is nearest to the origin, and the distance there."""
    dx, dy = end_x - begin_x, end_y - begin_y
    share = -(begin_x * dx + begin_y * dy) / (dx * dx + dy * dy + 1e-12)
    share = min(max(share, 0.0), 1.0)
    x, y = begin_x + share * dx, begin_y + share * dy
    return share, math.sqrt(x * x + y * y)


@compiled
def _near_pairs(
    t: FormationTables, durations: Array, ends: Array
) -> tuple[Indices, Array, Array, Array]:
    last = 0.0
    for i in range(durations.size):
        last = max(last, durations[i] + t.coast[i])
    interval = max(t.interval, last / _MOST_INSTANTS)
    count = math.ceil(last / interval) + 1
    n, pairs = durations.size, t.pairs.shape[0]
    most = pairs * max(count - 1, 0)
    pair, times = np.empty(most, dtype=np.intp), np.empty(most)
    margins, units = np.empty(most), np.empty((most, 2))
    expansions, found = taylor(t, ends), 0
    places = np.empty((n, 2, count))
    for i in range(n if pairs else 0):
        for k in range(count):
            x, y = _position(t, expansions, durations[i], i, k * interval)
            places[i, 0, k], places[i, 1, k] = x, y
    for p in range(pairs):
        i, j = t.pairs[p, 0], t.pairs[p, 1]
        within = (1.0 + t.near) * t.pair_clearances[p]
        x, y = places[i, 0, 0] - places[j, 0, 0], places[i, 1, 0] - places[j, 1, 0]
        for k in range(1, count):
            next_x, next_y = places[i, 0, k] - places[j, 0, k], places[i, 1, k] - places[j, 1, k]
            share, distance = _nearest(x, y, next_x, next_y)
            x, y = next_x, next_y
            if not distance < within:
                continue
            time = (k - 1 + share) * interval
            here = _position(t, expansions, durations[i], i, time)
            there = _position(t, expansions, durations[j], j, time)
            apart_x, apart_y = here[0] - there[0], here[1] - there[1]
            distance = max(math.sqrt(apart_x * apart_x + apart_y * apart_y), 1e-9)
            pair[found], times[found] = p, time
            margins[found] = distance / t.pair_clearances[p] - 1.0
            units[found, 0], units[found, 1] = apart_x / distance, apart_y / distance
            found += 1
    return pair[:found], times[:found], margins[:found], units[:found]


@compiled
def _near_circles(t: FormationTables, ends: Array) -> tuple[Indices, Indices, Array, Array, Array]:
    count, circles, m = t.circle_places.shape[0], t.centres.shape[0], ends.shape[2]
    most = t.moving.size * circles * (count - 1)
    robot, circle = np.empty(most, dtype=np.intp), np.empty(most, dtype=np.intp)
    arcs, margins, units = np.empty(most), np.empty(most), np.empty((most, 2))
    found = 0
    if most == 0:
        return robot, circle, arcs, margins, units
    expansions, places = taylor(t, ends), np.empty((2, count))
    for i in t.moving:
        for k in range(count):
            for axis in range(2):
                place = 0.0
                for j in range(m):
                    place += t.circle_places[k, j] * ends[i, axis, j]
                places[axis, k] = place
        for c in range(circles):
            within = (1.0 + t.near) * t.circle_clearances[i, c]
            for k in range(count - 1):
                share, distance = _nearest(
                    places[0, k] - t.centres[c, 0], places[1, k] - t.centres[c, 1],
                    places[0, k + 1] - t.centres[c, 0], places[1, k + 1] - t.centres[c, 1],
                )  # fmt: skip
                if not distance < within:
                    continue
                s = (k + share) / (count - 1)
                side, u = (0, s) if s <= 0.5 else (1, s - 1.0)
                x = polynomial(expansions[side, i, 0], u) - t.centres[c, 0]
                y = polynomial(expansions[side, i, 1], u) - t.centres[c, 1]
                distance = max(math.sqrt(x * x + y * y), 1e-9)
                robot[found], circle[found], arcs[found] = i, c, s
                margins[found] = distance / t.circle_clearances[i, c] - 1.0
                units[found, 0], units[found, 1] = x / distance, y / distance
                found += 1
    return robot[:found], circle[:found], arcs[:found], margins[:found], units[:found]
