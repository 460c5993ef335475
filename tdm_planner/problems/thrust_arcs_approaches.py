# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Distances between rounded polylines at equal times, and from what stands still, compiled."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.problems.thrust_arcs_kernels import (
    add_slope,
    Fleet,
    own_margins,
    own_slopes,
    place,
    round_off,
    smoothing,
)

Array = NDArray[np.float64]

# Columns of approaches: both indices, instant, distance / clearance - 1, way between them.
FIRST, SECOND, TIME, CLOSENESS, WAY = 0, 1, 2, 3, 4
COLUMNS = 6
_NEWTON_STEPS = 24
_REACH: Final = 1.25  # clearances within which an approach makes a row
_NEAR: Final = 0.3  # own margins below which they make a row
_FLOOR: Final = 2e-3  # smallest eigenvalue of a robot's Hessian


@compiled
def positions(times: Array, start: Array, velocity: Array, burns: Array) -> Array:
    """Positions (n, K, 2) of all at `times` (K,)."""
    n = burns.shape[0]
    found, at = np.zeros((n, times.size, 2)), np.zeros(6)
    for i in range(n):
        for k in range(times.size):
            place(times[k], start[i], velocity[i], burns[i], at)
            found[i, k, 0], found[i, k, 1] = at[0], at[1]
    return found


@compiled
def _nearest_between(
    low: float,
    high: float,
    t: float,
    accuracy: float,
    i: int,
    j: int,
    fleet: Fleet,
    burns: Array,
    approach: Array,
) -> float:
    """Fill in the approach of i and j between two instants, by Newton's method; the distance."""
    one, other = np.zeros(6), np.zeros(6)
    start, velocity = fleet.start, fleet.velocity
    for _ in range(_NEWTON_STEPS):
        place(t, start[i], velocity[i], burns[i], one)
        place(t, start[j], velocity[j], burns[j], other)
        one -= other
        rate = one[0] * one[2] + one[1] * one[3]
        if rate > 0.0:
            high = t
        else:
            low = t
        bend = one[2] ** 2 + one[3] ** 2 + one[0] * one[4] + one[1] * one[5]
        better = t - rate / bend if bend > 0.0 else high
        if not low < better < high:
            better = 0.5 * (low + high)
        done = abs(better - t) < accuracy
        t = better
        if done:
            break
    place(t, start[i], velocity[i], burns[i], one)
    place(t, start[j], velocity[j], burns[j], other)
    approach[FIRST], approach[SECOND], approach[TIME] = i, j, t
    approach[WAY], approach[WAY + 1] = one[0] - other[0], one[1] - other[1]
    return math.hypot(approach[WAY], approach[WAY + 1])


@compiled
def approaches(fleet: Fleet, burns: Array, last: float, found: Array) -> int:
    """
    Fill in the local minima in time of all distances that are near their clearances.

    `found` (r, 6) has a row for each; returns how many.
    """
    every = len(burns)
    steps = max(math.ceil(last / fleet.interval), 2)
    step = last / steps
    path = positions(step * np.arange(steps + 1.0), fleet.start, fleet.velocity, burns)
    squares = np.zeros(steps + 1)
    count = 0
    for i in range(every):
        for j in range(i + 1, every):
            clearance = fleet.clearances[i, j]
            if clearance == 0.0:
                continue
            limit = (_REACH * clearance) ** 2
            for k in range(steps + 1):
                x, y = path[i, k, 0] - path[j, k, 0], path[i, k, 1] - path[j, k, 1]
                squares[k] = x * x + y * y
            for k in range(1, steps + 1):
                falls = squares[k] <= squares[k - 1]
                rises = k == steps or squares[k] < squares[k + 1]
                if not (falls and rises) or squares[k] > 1.1 * limit or count == len(found):
                    continue
                low, high = (k - 1) * step, min(k + 1, steps) * step
                distance = _nearest_between(
                    low, high, k * step, 1e-5 * step, i, j, fleet, burns, found[count]
                )
                found[count, CLOSENESS] = distance / clearance - 1.0
                if found[count, CLOSENESS] < _REACH - 1.0:
                    count += 1
    return count


@compiled
def evaluate(
    x: Array, fleet: Fleet, burns: Array, slopes: Array, margins: Array, found: Array
) -> tuple[int, float, float]:
    """
    Burns, own margins and approaches at the varied parameters x (n, v).

    Returns the number of approaches, all gas, rounded off at zero, and the least margin. `burns`
    (N, m, 4) of what is not varied are left as they are.
    """
    n, m = len(x), burns.shape[1]
    last, gas, worst = 0.0, 0.0, 1.0
    for i in range(n):
        last = max(last, x[i, x.shape[1] - 1])
        if not fleet.varied[i]:
            continue
        round_off(x[i], fleet, i, burns[i], slopes[i])
        for k in range(m):
            e = smoothing(fleet, i, k, m)
            gas += math.sqrt(burns[i, k, 0] ** 2 + burns[i, k, 1] ** 2 + e * e) - e
        own_margins(x[i], fleet, i, burns[i], margins[i])
        worst = min(worst, margins[i].min())
    count = approaches(fleet, burns, last, found)
    for r in range(count):
        worst = min(worst, found[r, CLOSENESS])
    return count, gas, worst


@compiled
def _approach_row(approach: Array, fleet: Fleet, burns: Array, slopes: Array, row: Array) -> None:
    """Add the slopes of distance / clearance - 1 of an approach to `row` (n, v)."""
    i, j, t = int(approach[FIRST]), int(approach[SECOND]), approach[TIME]
    distance = math.hypot(approach[WAY], approach[WAY + 1])
    along = approach[WAY:] / (max(distance, 1e-9) * fleet.clearances[i, j])
    if fleet.varied[i]:
        add_slope(t, burns[i], slopes[i], along, row[i])
    if j < len(row) and fleet.varied[j]:
        add_slope(t, burns[j], slopes[j], -along, row[j])


@compiled
def derivatives(
    x: Array,
    fleet: Fleet,
    burns: Array,
    slopes: Array,
    margins: Array,
    found: Array,
    weight: float,
    gradient: Array,
    hessian: Array,
    rows: Array,
    values: Array,
) -> int:
    """
    Slopes by the scaled parameters: of `weight` times the gas (n, v), (n, v, n, v), and of rows.

    `rows` (r, n, v) hold those of the approaches `found`, then those of own margins near active;
    `values` (r,) are the margins. The Hessian's eigenvalues are lifted. Returns how many rows
    there are.
    """
    n, v = x.shape
    m = margins.shape[1]
    block, by = np.zeros((v, v)), np.zeros((m, v))
    count = len(found)
    for r in range(count):
        values[r] = found[r, CLOSENESS]
        _approach_row(found[r], fleet, burns, slopes, rows[r])
    for i in range(n):
        if not fleet.varied[i]:
            for q in range(v):
                hessian[i, q, i, q] = _FLOOR
            continue
        own_slopes(x[i], fleet, i, slopes[i], burns[i], gradient[i], block, by)
        for k in range(m):
            if margins[i, k] < _NEAR:
                values[count] = margins[i, k]
                rows[count, i] = by[k]
                count += 1
        for q in range(v):
            gradient[i, q] *= weight * fleet.units[i, q]
            for r in range(v):
                block[q, r] *= weight * fleet.units[i, q] * fleet.units[i, r]
        sizes, vectors = np.linalg.eigh(block)
        for q in range(v):
            size = max(sizes[q], _FLOOR)
            for r in range(v):
                for c in range(v):
                    hessian[i, r, i, c] += size * vectors[r, q] * vectors[c, q]
    for r in range(count):
        for i in range(n):
            for q in range(v):
                rows[r, i, q] *= fleet.units[i, q]
    return count
