# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Compiled: distances between the robots at equal times (19), and from what stands still.

Motions are sampled at common instants; between two instants the nearest approach is where the
chords of the motions are nearest, and there the distance and its gradient are taken exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled, inlined

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOST_INSTANTS = 4000
_NEWTON_STEPS, _MOST_STEPS = 12, 80  # of the inversion of time
NEAR = 0.6  # approaches within this share beyond the clearance become rows


class SeparationTables(NamedTuple):
    """
    What does not change from one Xi to another; m: end derivatives of one coordinate.

    `shapes` (m, nf): end derivatives of the varied shapes; `taylor` (2, m, m): expansions about
    s = 0 and 1; `passing` (q + 1, q + 2): powers of s in the time at s, by b; `slope` (q + 1,):
    mu_s at the start, by b. `acceleration` (n, 2) is that given at the start; `given`: 1 where it
    is, else 0. `wall_places` (W, m): values at the arcs for walls. Pairs are `pairs` (p, 2) with
    clearances (p,): of robots, and of robots and what stands still at the `centres` (c, 2), which
    counts on from the last robot. Common instants are `interval` s apart.
    """

    shapes: Array
    taylor: Array
    passing: Array
    slope: Array
    wall_places: Array
    fixed: Array
    velocity: Array
    acceleration: Array
    given: float
    coast: Array
    wall_clearances: Array
    sides: Array
    separation: float
    pairs: Indices
    pair_clearances: Array
    centres: Array
    interval: float


class PairApproaches(NamedTuple):
    """
    Near approaches: index of the pair (r,) and instant [s] (r,).

    `margins` (r,) are distance / clearance - 1, `unit` (r, 2) points from the second to the first.
    """

    pair: Indices
    time: Array
    margins: Array
    unit: Array


class Paths(NamedTuple):
    """
    Motions of all robots.

    `durations` (n,) s, end derivatives `ends` (n, 2, m), powers of s in the time since the
    manoeuvre began `times` (n, q + 2), Taylor coefficients about both ends `expansions`
    (n, 2, 2, m).
    """

    durations: Array
    ends: Array
    times: Array
    expansions: Array


@compiled
def paths(t: SeparationTables, xi: Array) -> Paths:
    """Paths at the varied parameters xi (n, P), not scaled."""
    n, (m, nf), nb = xi.shape[0], t.shapes.shape, t.slope.size
    ends = t.fixed.copy()
    expansions = np.empty((n, 2, 2, m))
    durations, times = np.zeros(n), np.zeros((n, nb + 1))
    for i in range(n):
        mu, slope = xi[i, 0], 0.0
        for k in range(nb):
            slope += t.slope[k] * xi[i, k]
            for power in range(nb + 1):
                times[i, power] += t.passing[k, power] * xi[i, k]
            durations[i] += xi[i, k] / nb
        for axis in range(2):
            end, first = ends[i, axis], nb + axis * nf
            v, a = t.velocity[i, axis], t.acceleration[i, axis]
            end[1] += mu * v
            end[2] += t.given * (mu**2 * a + slope * v)
            for j in range(m):
                for q in range(nf):
                    end[j] += t.shapes[j, q] * xi[i, first + q]
            for side in range(2):
                for k in range(m):
                    x = 0.0
                    for j in range(m):
                        x += t.taylor[side, k, j] * end[j]
                    expansions[i, side, axis, k] = x
    return Paths(durations, ends, times, expansions)


@inlined
def _value(coefficients: Array, u: float) -> float:
    """Value at u of the polynomial with Taylor coefficients (m,)."""
    value = 0.0
    for k in range(coefficients.size - 1, -1, -1):
        value = value * u + coefficients[k]
    return value


@compiled
def _slope(coefficients: Array, u: float) -> float:
    value = 0.0
    for k in range(coefficients.size - 1, 0, -1):
        value = value * u + k * coefficients[k]
    return value


@inlined
def _arc(at: Paths, i: int, since: float) -> float:
    """Return s in [0, 1] at an instant since the manoeuvre began [s]."""
    if at.times.shape[1] == 2:
        s: float = min(max(since / at.times[i, 1], 0.0), 1.0)
        return s
    return _inverse(at.times[i], at.durations[i], since)


@compiled
def _inverse(times: Array, duration: float, since: float) -> float:
    """Invert a polynomial that rises on [0, 1] from 0: Newton's method in a bracket."""
    if not 0.0 < since < duration:
        return 0.0 if since < duration else 1.0
    low, high, s = 0.0, 1.0, since / duration
    for step in range(_MOST_STEPS):
        error = _value(times, s) - since
        if abs(error) <= 1e-15 * duration:
            break
        if error < 0.0:
            low = s
        else:
            high = s
        last, s = s, s - error / _slope(times, s)
        if not low <= s <= high or (step >= _NEWTON_STEPS and step % 3 == 2):
            s = 0.5 * (low + high)
        if s == last:
            break
    return s


@inlined
def _place(
    at: Paths, coast: Array, velocity: Array, centres: Array, i: int, time: float
) -> tuple[float, float]:
    """Where a robot is: coasting, on its way, or parked; or where something stands still."""
    n = coast.size
    if i >= n:
        return centres[i - n, 0], centres[i - n, 1]
    since = time - coast[i]
    s = _arc(at, i, since)
    side, u = (0, s) if s <= 0.5 else (1, s - 1.0)
    x, y = 0.0, 0.0
    for k in range(at.expansions.shape[3] - 1, -1, -1):
        x, y = x * u + at.expansions[i, side, 0, k], y * u + at.expansions[i, side, 1, k]
    early = min(since, 0.0)
    return x + velocity[i, 0] * early, y + velocity[i, 1] * early


@compiled
def walls(t: SeparationTables, ends: Array) -> Array:
    """Margins [robot, side, axis, arc]."""
    n, count = ends.shape[0], t.wall_places.shape[0]
    found = np.empty((n, 2, 2, count))
    for i in range(n):
        for axis in range(2):
            for k in range(count):
                place = 0.0
                for j in range(ends.shape[2]):
                    place += t.wall_places[k, j] * ends[i, axis, j]
                low = place - t.wall_clearances[i, axis, 0]
                high = t.sides[axis] - t.wall_clearances[i, axis, 1] - place
                found[i, 0, axis, k] = low / t.separation
                found[i, 1, axis, k] = high / t.separation
    return found


@inlined
def _nearest(begin_x: float, begin_y: float, end_x: float, end_y: float) -> tuple[float, float]:
    """Share of the chord at which it is nearest to the origin, and the distance there."""
    dx, dy = end_x - begin_x, end_y - begin_y
    share = -(begin_x * dx + begin_y * dy) / (dx * dx + dy * dy + 1e-12)
    share = min(max(share, 0.0), 1.0)
    x, y = begin_x + share * dx, begin_y + share * dy
    return share, math.sqrt(x * x + y * y)


@compiled
def near_pairs(t: SeparationTables, at: Paths) -> PairApproaches:
    """Find the near approaches of robots to one another and to what stands still."""
    coast, velocity, centres = t.coast, t.velocity, t.centres
    every, pairs, last = at.durations.size + len(t.centres), t.pairs.shape[0], 0.0
    for i in range(at.durations.size):
        last = max(last, at.durations[i] + t.coast[i])
    # A motion far longer than its time scale keeps the number of instants, not the interval.
    interval = max(t.interval, last / _MOST_INSTANTS)
    count = math.ceil(last / interval) + 1
    most = pairs * max(count - 1, 0)
    pair, times = np.empty(most, dtype=np.intp), np.empty(most)
    margins, units = np.empty(most), np.empty((most, 2))
    found, places = 0, np.empty((every, 2, count))
    for i in range(every if pairs else 0):
        for k in range(count):
            x, y = _place(at, coast, velocity, centres, i, k * interval)
            places[i, 0, k], places[i, 1, k] = x, y
    for p in range(pairs):
        i, j = t.pairs[p, 0], t.pairs[p, 1]
        within = (1.0 + NEAR) * t.pair_clearances[p]
        x, y = places[i, 0, 0] - places[j, 0, 0], places[i, 1, 0] - places[j, 1, 0]
        for k in range(1, count):
            next_x, next_y = places[i, 0, k] - places[j, 0, k], places[i, 1, k] - places[j, 1, k]
            share, distance = _nearest(x, y, next_x, next_y)
            x, y = next_x, next_y
            if not distance < within:
                continue
            time = (k - 1 + share) * interval
            here = _place(at, coast, velocity, centres, i, time)
            there = _place(at, coast, velocity, centres, j, time)
            apart_x, apart_y = here[0] - there[0], here[1] - there[1]
            distance = max(math.sqrt(apart_x * apart_x + apart_y * apart_y), 1e-9)
            pair[found], times[found] = p, time
            margins[found] = distance / t.pair_clearances[p] - 1.0
            units[found, 0], units[found, 1] = apart_x / distance, apart_y / distance
            found += 1
    return PairApproaches(pair[:found], times[:found], margins[:found], units[:found])


@compiled
def separation_rows(
    t: SeparationTables,
    at: Paths,
    near_walls: Array,
    below: float,
    pairs: PairApproaches,
    margins: Array,
    rows: Array,
) -> None:
    """Write margins (r,) of walls that are `below`, and of pairs; their slopes (r, n, P)."""
    r, m = 0, t.taylor.shape[1]
    for i in range(near_walls.shape[0]):
        for side in range(2):
            sign = (1.0 if side == 0 else -1.0) / t.separation
            for axis in range(2):
                x, y = (sign, 0.0) if axis == 0 else (0.0, sign)
                for k in range(t.wall_places.shape[0]):
                    if near_walls[i, side, axis, k] < below:
                        _add_slope(t, at, i, t.wall_places[k], x, y, rows[r, i])
                        margins[r] = near_walls[i, side, axis, k]
                        r += 1
    values = np.empty(m)
    for a in range(pairs.pair.size):
        for end in range(2):
            i = t.pairs[pairs.pair[a], end]
            if i >= rows.shape[1]:
                continue  # it stands still
            scale = (1.0 - 2.0 * end) / t.pair_clearances[pairs.pair[a]]
            x, y = scale * pairs.unit[a, 0], scale * pairs.unit[a, 1]
            s, row = _arc(at, i, pairs.time[a] - t.coast[i]), rows[r, i]
            _add_slope(t, at, i, _values(t, s, values), x, y, row)
            if 0.0 < s < 1.0:  # at a fixed instant the arc changes with the speed
                _subtract_passing(t, at, i, s, x, y, row)
        margins[r] = pairs.margins[a]
        r += 1


@compiled
def _values(t: SeparationTables, s: float, values: Array) -> Array:
    """Fill in the polynomials by their end derivatives, at the arc s."""
    side, u = (0, s) if s <= 0.5 else (1, s - 1.0)
    for j in range(values.size):
        values[j] = _value(t.taylor[side, :, j], u)
    return values


@compiled
def _add_slope(
    t: SeparationTables, at: Paths, i: int, values: Array, x: float, y: float, row: Array
) -> None:
    """Add the slope, along (x, y), of robot i's place at a fixed arc to `row` (P,)."""
    (m, nf), nb = t.shapes.shape, t.slope.size
    for q in range(nf):
        shape = 0.0
        for j in range(m):
            shape += values[j] * t.shapes[j, q]
        row[nb + q] += x * shape
        row[nb + nf + q] += y * shape
    v = x * t.velocity[i, 0] + y * t.velocity[i, 1]
    a = x * t.acceleration[i, 0] + y * t.acceleration[i, 1]
    row[0] += values[1] * v + 2.0 * t.given * values[2] * at.times[i, 1] * a
    for k in range(nb):
        row[k] += t.given * values[2] * t.slope[k] * v


@compiled
def _subtract_passing(
    t: SeparationTables, at: Paths, i: int, s: float, x: float, y: float, row: Array
) -> None:
    side, u = (0, s) if s <= 0.5 else (1, s - 1.0)
    speed = x * _slope(at.expansions[i, side, 0], u) + y * _slope(at.expansions[i, side, 1], u)
    speed /= _slope(at.times[i], s)
    for k in range(t.slope.size):
        row[k] -= speed * _value(t.passing[k], s)
