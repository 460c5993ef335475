# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled: near approaches of robots to one another and to what stands still, whatever their form.

Every form of motion brings two functions. `place(motion, i, t, at)` fills in position, velocity
and acceleration (6,) of the i-th at an instant t [s]: first come the robots, then what stands
still. `add_slope(motion, i, t, along, row)` adds to `row` (P,) the slopes of `along` (2,) times
robot i's position, at a fixed instant, by its varied parameters.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled, inlined

Array = NDArray[np.float64]

# Columns of approaches: both indices, instant, distance / clearance - 1, way between them.
FIRST, SECOND, TIME, CLOSENESS, WAY = 0, 1, 2, 3, 4
COLUMNS = 6
_REACH = 1.25  # clearances within which an approach makes a row
_MOST_INSTANTS = 4000
_NEWTON_STEPS = 24


@inlined
def approaches(
    place: Any, motion: Any, clearances: Array, last: float, interval: float, found: Array
) -> int:
    """
    Fill in the local minima in time, until `last` [s], of distances that are near `clearances`.

    Those are (N, N), zero for what does not count; minima are looked for between instants
    `interval` s apart. `found` (r, 6) has a row for each; returns how many.
    """
    every = len(clearances)
    # A motion far longer than its time scale keeps the number of instants, not the interval.
    steps = max(math.ceil(min(last / interval, _MOST_INSTANTS)), 2)
    step = last / steps
    path, at = np.zeros((every, steps + 1, 2)), np.zeros(6)
    for i in range(every):
        for k in range(steps + 1):
            place(motion, i, k * step, at)
            path[i, k, 0], path[i, k, 1] = at[0], at[1]
    squares = np.zeros(steps + 1)
    count = 0
    for i in range(every):
        for j in range(i + 1, every):
            clearance = clearances[i, j]
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
                _nearest(place, motion, i, j, low, high, k * step, 1e-5 * step, found[count])
                distance = math.hypot(found[count, WAY], found[count, WAY + 1])
                found[count, CLOSENESS] = distance / clearance - 1.0
                if found[count, CLOSENESS] < _REACH - 1.0:
                    count += 1
    return count


@inlined
def _nearest(
    place: Any,
    motion: Any,
    i: int,
    j: int,
    low: float,
    high: float,
    t: float,
    accuracy: float,
    approach: Array,
) -> None:
    """Fill in the approach of i and j between two instants, by Newton's method from `t` on."""
    one, other = np.zeros(6), np.zeros(6)
    for _ in range(_NEWTON_STEPS):
        place(motion, i, t, one)
        place(motion, j, t, other)
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
    place(motion, i, t, one)
    place(motion, j, t, other)
    approach[FIRST], approach[SECOND], approach[TIME] = i, j, t
    approach[WAY], approach[WAY + 1] = one[0] - other[0], one[1] - other[1]


@inlined
def approach_rows(
    add_slope: Any,
    motion: Any,
    varied: NDArray[np.bool_],
    clearances: Array,
    found: Array,
    rows: Array,
    margins: Array,
) -> None:
    """Fill in distance / clearance - 1 of approaches `found` (r, 6), and slopes (r, n, P)."""
    for r in range(len(found)):
        i, j, t = int(found[r, FIRST]), int(found[r, SECOND]), found[r, TIME]
        distance = max(math.hypot(found[r, WAY], found[r, WAY + 1]), 1e-9)
        along = found[r, WAY:] / (distance * clearances[i, j])
        margins[r] = found[r, CLOSENESS]
        if varied[i]:
            add_slope(motion, i, t, along, rows[r, i])
        if j < rows.shape[1] and varied[j]:
            add_slope(motion, j, t, -along, rows[r, j])


@compiled
def scaled(units: Array, blocks: Array, least: float, share: float, rows: Array) -> Array:
    """
    Hessian (n P, n P) by parameters in `units` (n, P), from that of every robot, (n, P, P).

    Its eigenvalues are lifted to `least`, or a `share` of the largest. `rows` (r, n, P) are
    scaled in place.
    """
    n, v = units.shape
    hessian = np.zeros((n, v, n, v))
    for i in range(n):
        sizes, vectors = np.linalg.eigh(blocks[i] * units[i] * units[i].reshape(-1, 1))
        for q in range(v):
            size = max(sizes[q], least, share * sizes[v - 1])
            for r in range(v):
                for c in range(v):
                    hessian[i, r, i, c] += size * vectors[r, q] * vectors[c, q]
    for r in range(len(rows)):
        rows[r] *= units
    return hessian.reshape(n * v, n * v)
