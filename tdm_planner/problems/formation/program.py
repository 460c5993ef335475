# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The nonlinear program of section 4.2, whatever form the motions have: performance index (28).

A form of motion brings its varied parameters, the gas they use, and the limits of every robot;
arrivals, their intervals and the distances of robots at equal times (19) are the same for all.

Near approaches of robots to one another, and to what stands still, are compiled. For them every
form of motion brings two functions. `place(motion, i, t, at)` fills in position, velocity and
acceleration (6,) of the i-th at an instant t [s]: first come the robots, then what stands still.
`add_slope(motion, i, t, along, row)` adds to `row` (P,) the slopes of `along` (2,) times robot i's
position, at a fixed instant, by its varied parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
from tdm_planner.arrays import Array, Mask
from tdm_planner.direct_method.nonlinear_program import (
    Linearisation,
    Multipliers,
    NonlinearProgram,
    Point,
)
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.problems.formation.task import FormationTask

_INSTANTS = 80  # in a typical manoeuvre, between which approaches are looked for
# Columns of approaches: both indices, instant, distance / clearance - 1, way between them.
FIRST, SECOND, TIME, CLOSENESS, WAY = 0, 1, 2, 3, 4
_REACH = 1.25  # clearances within which an approach makes a row
_MOST_INSTANTS = 4000
_NEWTON_STEPS = 24


@inlined
def approaches(
    place: Any, motion: Any, clearances: Array, last: float, interval: float
) -> tuple[Array, float]:
    """
    Return the local minima (r, 6) in time, until `last` [s], of distances near `clearances`.

    Those are (N, N), zero for what does not count; minima are looked for between instants
    `interval` s apart. The least closeness comes with them, 1 where there is none.
    """
    every = len(clearances)
    found = np.zeros((16 + every * every, WAY + 2))
    # A motion far longer than its time scale keeps the number of instants, not the interval.
    steps = max(math.ceil(min(last / interval, _MOST_INSTANTS)), 2)
    step = last / steps
    path, at = np.zeros((every, steps + 1, 2)), np.zeros(6)
    for i in range(every):
        for k in range(steps + 1):
            place(motion, i, k * step, at)
            path[i, k, 0], path[i, k, 1] = at[0], at[1]
    squares, count, least = np.zeros(steps + 1), 0, 1.0
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
                    least = min(least, found[count, CLOSENESS])
                    count += 1
    return found[:count], least


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
    varied: Mask,
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
    rows *= units
    return hessian.reshape(n * v, n * v)


class FormationProgram(NonlinearProgram):
    """
    The program of one manoeuvre in the scaled varied parameters that are free, Xi (m,).

    A robot has parameters x (n, P), in `units` (n, P) of the same shape; it arrives `coast` plus
    x @ `arriving` (P,) s after the start. Where robots are `kept` (n,) nothing is varied, `fixed`
    (n, P) holds their x; robots that stay vary what `turning` (P,) marks. Violations count
    relative to their limits. `first` [s] is when the first robot may well arrive, `scale` a
    typical J, by which the cost is divided.

    Two functions of `kernels` take the `manoeuvre` as that form of motion has it. `evaluate`
    returns the motions at x: `x`, all `gas` [m/s], the `worst` margin, every robot's `own` margins
    (n, c), `approaches` (r, 6). `derivatives` returns the slopes (n, P) and curvature (n, P, P) of
    a weight times the gas, margins near active (r,) and their slopes (r, n, P). `limits` are a
    robot's own, in words, and how many of `own` each makes.
    """

    kernels: ModuleType
    manoeuvre: Any
    limits: Mapping[str, int]
    curvature: ClassVar[tuple[float, float]]  # least eigenvalue of a robot's Hessian, and share

    def __init__(
        self,
        task: FormationTask,
        first: float,
        units: Array,
        arriving: Array,
        turning: Mask,
        kept: Mask,
    ) -> None:
        self.task, self.first, self.units, self.size = task, first, units, arriving.size
        self.kept, self.varied = kept, ~(task.staying | kept)
        way = np.linalg.norm(task.goal - task.departure, axis=1).sum()
        # Robots that only turn have no way, but their gas is rounded off at zero.
        typical = (
            2.4 * max(way, 0.1 * task.separation) / self.first
            + np.linalg.norm(task.velocity, axis=1).sum()
        )
        self.scale = float(max(task.weights[[0, 2]] @ [self.first, typical], 1e-9))
        self.weights = task.weights / self.scale
        free = np.where(task.staying[:, None], turning, True) & ~kept[:, None]
        self.free = np.flatnonzero(free.ravel())
        self._scales = units * free
        (self.low, self.high), (self.centres, apart) = task.wall_bounds(), task.zones()
        self.clearances = self._clearances(apart)
        self.interval = self.first / _INSTANTS
        arrivals = np.zeros((task.n, task.n, self.size))
        arrivals[np.arange(task.n), np.arange(task.n)] = arriving * units
        arrivals = arrivals.reshape(task.n, -1)[:, self.free]
        self._used = np.flatnonzero(arriving)
        self._speeds = arriving[self._used]
        self._arrived = task.coast - task.arrived
        self._first, self._intervals = self.weights[0] * arrivals[0], np.diff(arrivals, axis=0)

    def _clearances(self, apart: Array) -> Array:
        """Clearances (N, N) of all from one another; none where both stand still or are kept."""
        task, n, count = self.task, self.task.n, len(self.centres)
        found = np.zeros((n + count, n + count))
        found[np.triu_indices(n, 1)] = task.pair_clearances()
        found[:n, n:] = apart
        still = np.concatenate([~self.varied, np.ones(count, dtype=bool)])
        found[np.ix_(still, still)] = 0.0
        return found

    def bound(self, lower: Array, upper: Array, fixed: Array) -> None:
        """Bound the parameters x (n, P), in SI units; `fixed` (n, P) holds those not varied."""
        self.fixed = fixed
        self.lower, self.upper = self.reduce(lower), self.reduce(np.maximum(lower, upper))

    def full(self, xi: Array) -> Array:
        """Parameters x (n, P) in SI units of every robot."""
        x = self.fixed.ravel().copy()
        x[self.free] = xi * self.units.ravel()[self.free]
        return x.reshape(self.fixed.shape)

    def reduce(self, x: Array) -> Array:
        """Take the free parameters of x (n, P), scaled."""
        return np.asarray((x / self.units).ravel()[self.free])

    def durations(self, x: Array) -> Array:
        """Time that every motion takes after its coast, (n,) s."""
        return np.asarray(x[:, self._used] @ self._speeds)

    def usual_durations(self) -> Array:
        """Durations (n,) s of initial guesses."""
        task = self.task
        least = self.durations(self.full(self.lower))
        arrivals = self.first + task.interval * np.arange(task.n) + task.arrived - task.coast
        found = np.minimum(np.maximum(arrivals, least), 0.98 * task.longest)
        return np.where(task.staying, least, found)

    def evaluate(self, xi: Array) -> Point:
        """Return the performance index, relative to a typical one, and the worst violation."""
        flown = self.kernels.evaluate(self.manoeuvre, self.full(xi))
        first, late = self._late(flown.x)
        time, sequence, gas_weight = self.weights
        cost = time * first + sequence * np.abs(late).sum() + gas_weight * flown.gas
        return Point(xi, float(cost), np.array([max(0.0, -flown.worst)]), flown)

    def _late(self, x: Array) -> tuple[float, Array]:
        """Return when the first robot arrives, and by how much the others are off (n - 1,)."""
        arrivals = self.durations(x) + self._arrived
        return float(arrivals[0]), arrivals[1:] - arrivals[:-1] - self.task.interval

    def linearise(self, point: Point, multipliers: Multipliers | None) -> Linearisation:
        """Exact first derivatives; Hessian of the gas, made positive definite."""
        given = self.manoeuvre, point.cache, self.weights[2]
        gradient, blocks, margins, rows = self.kernels.derivatives(*given)
        curvature = scaled(self._scales, blocks, *self.curvature, rows)
        jacobian = rows.reshape(margins.size, gradient.size)
        gradient = (self._scales * gradient).ravel()
        if self.free.size < gradient.size:
            curvature = curvature[np.ix_(self.free, self.free)]
            gradient, jacobian = gradient[self.free], jacobian[:, self.free]
        return Linearisation(
            gradient=gradient + self._first,
            hessian=curvature,
            equalities=np.zeros(0),
            equality_jacobian=np.zeros((0, self.free.size)),
            inequalities=margins,
            inequality_jacobian=jacobian,
            inequality_groups=np.zeros(margins.size, dtype=np.intp),
            terms=self._late(point.cache.x)[1],
            terms_jacobian=self._intervals,
            term_weights=np.full(self.task.n - 1, self.weights[1]),
        )

    def binding(self, point: Point) -> str:
        """Name what is violated most at `point`, in words."""
        names, approaches = self.task.names, point.cache.approaches
        found, last = {}, 0
        for label, count in self.limits.items():
            first, last = last, last + count
            worst = point.cache.own[:, first:last].min(axis=1)
            found[label.format(names[int(np.argmin(worst))])] = float(worst.min())
        if len(approaches):
            nearest = approaches[int(np.argmin(approaches[:, CLOSENESS]))]
            one, other = nearest[:2].astype(int)
            label = f"the distance of '{names[one]}' from keep-out zones"
            if other < len(names):
                label = f"arena.minimum_separation of '{names[one]}' and '{names[other]}'"
            found[label] = float(nearest[CLOSENESS])
        return min(found, key=lambda label: found[label])
