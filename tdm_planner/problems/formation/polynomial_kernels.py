# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled: gas and limits (17), (18) of robots whose motions are polynomials, at Chebyshev nodes.

What holds at one node is stated once, in `push` and `turn`; their slopes are derived from that and
chained with those of the end derivatives, in which the polynomials are linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.arrays import Array, Mask
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.slopes import with_slopes
from tdm_planner.problems.formation.program import approach_rows, approaches
from tdm_planner.problems.formation.reference_motion import acceleration, arc_at, Grid, powers_at

Numbers = Sequence[Any]

_GAS_SMOOTHING = 0.03  # share of F_max by which |F| is rounded off at zero
_THRUST_SHARE = 0.99  # of F_max planned with: what lies between nodes, and repairs, need the rest
_ROUNDED = 1e-6  # of F_max, by which the margin of thrust is rounded off at zero
_IRRELEVANT = 2.0  # a margin that makes no row


def push(local: Numbers, thrust: Any, torque: Any) -> tuple[Any, ...]:
    """
    Return gas per arc [m/s], rounded off at zero, and margins 1 - F / F_max, 1 - |T| / T_max.

    `local`: mu, mu_s, x_s, x_ss, y_s, y_ss, yaw_s, yaw_ss.
    """
    mu, mu_s = local[:2]
    square = acceleration(mu, mu_s, *local[2:4]) ** 2 + acceleration(mu, mu_s, *local[4:6]) ** 2
    limit = _THRUST_SHARE * thrust
    gas = np.sqrt(square + (_GAS_SMOOTHING * thrust) ** 2) * mu
    pushed = 1.0 - np.sqrt(square + (_ROUNDED * limit) ** 2) / limit
    return gas, pushed, 1.0 - np.abs(acceleration(mu, mu_s, *local[6:8])) / torque


_LOCAL, _VALUES = 8, 3  # local variables, values
_push = inlined(with_slopes(push, (), local=_LOCAL))
_push_with_curvature = inlined(with_slopes(push, ('local',), curved=True, local=_LOCAL))
_CURVATURE = _VALUES * (1 + _LOCAL)  # where it begins among the results


class Manoeuvre(NamedTuple):
    """
    One manoeuvre, as the kernels take it.

    `fixed` (n, 3, m) is what is given of the end derivatives of x, y and yaw, `velocity` and
    `acceleration` (n, 3) the start's. Walls are at `low` and `high` (n, 2); clearances (N, N) as
    `FormationProgram` has them, of robots and of what stands still at the `centres` (c, 2). `kept`
    (n,) are not `varied`.
    """

    grid: Grid
    fixed: Array
    velocity: Array
    acceleration: Array
    coast: Array
    thrust: float
    torque: float
    low: Array
    high: Array
    separation: float
    clearances: Array
    centres: Array
    interval: float
    kept: Mask
    varied: Mask


class Values(NamedTuple):
    """
    What is known at one x (n, P); margins are relative to their limits, negative if violated.

    All `gas` [m/s] and the `worst` margin; `own` margins (n, 2 K + 4 W) of every robot: of thrust
    at the nodes, of torque there, and of walls at the arcs, by axis and side; `approaches` (r, 6);
    `ends` (n, 3, m), the end derivatives; powers of s in the time `times` (n, q + 2), Taylor
    coefficients about both ends (n, 2, 2, m).
    """

    x: Array
    gas: float
    worst: float
    own: Array
    approaches: Array
    ends: Array
    times: Array
    expansions: Array


@compiled
def unpacked(t: Manoeuvre, x: Array) -> Array:
    """End derivatives by s, (n, 3, m), at the varied parameters x (n, P)."""
    g, ends = t.grid, t.fixed.copy()
    for i in range(len(x)):
        mu, mu_s = x[i, 0], g.slope @ x[i, : g.slope.size]
        for axis in range(3):
            ends[i, axis] += g.shapes[axis] @ x[i]
            v, a = t.velocity[i, axis], t.acceleration[i, axis]
            ends[i, axis, 1] += mu * v
            ends[i, axis, 2] += g.given[axis] * (mu**2 * a + mu_s * v)
    return ends


@compiled
def _by_parameters(t: Manoeuvre, x: Array, i: int) -> Array:
    """Slopes (3, m, P) of robot i's end derivatives by its x (P,)."""
    g, by = t.grid, t.grid.shapes.copy()
    for axis in range(3):
        v, a = t.velocity[i, axis], t.acceleration[i, axis]
        by[axis, 1, 0] += v
        by[axis, 2, 0] += g.given[axis] * 2.0 * x[0] * a
        by[axis, 2, : g.slope.size] += g.given[axis] * v * g.slope
    return by


@compiled
def _locals(g: Grid, x: Array, ends: Array) -> Array:
    """Return what `push` wants of one robot, at all nodes (K, 8)."""
    at = np.empty((g.weights.size, _LOCAL))
    for d in range(2):
        at[:, d] = g.rates[d] @ x[: g.slope.size]
        for axis in range(3):
            at[:, 2 + 2 * axis + d] = g.paths[axis, d] @ ends[axis]
    return at


@compiled
def evaluate(t: Manoeuvre, x: Array) -> Values:
    """Gas and margins at the varied parameters x (n, P)."""
    g, n, nb = t.grid, len(x), t.grid.slope.size
    ends, count, gas = unpacked(t, x), g.weights.size, 0.0
    own, at_nodes = np.full((n, g.active.size), _IRRELEVANT), 2 * count
    times, expansions, last = np.zeros((n, nb + 1)), np.zeros((n, 2, 2, ends.shape[2])), 0.0
    for i in range(n):
        times[i] = x[i, :nb] @ g.passing
        last = max(last, t.coast[i] + times[i].sum())
        for side in range(2):
            for axis in range(2):
                expansions[i, side, axis] = g.taylor[side] @ ends[i, axis]
        if t.kept[i]:
            continue
        at = _locals(g, x[i], ends[i])
        for k in range(count):
            used, own[i, k], own[i, count + k] = _push(at[k], t.thrust, t.torque)
            gas += g.weights[k] * used
        walls = own[i, at_nodes:].reshape(2, 2, len(g.places))
        for axis in range(2):
            places = g.places @ ends[i, axis]
            walls[axis, 0] = (places - t.low[i, axis]) / t.separation
            walls[axis, 1] = (t.high[i, axis] - places) / t.separation
    motion = t, times, expansions
    near, worst = approaches(_place, motion, t.clearances, last, t.interval)
    return Values(x, gas, min(worst, own.min()), own, near, ends, times, expansions)


@compiled
def _place(motion: tuple[Manoeuvre, Array, Array], i: int, time: float, at: Array) -> None:
    """Where a robot is: coasting, on its way, or parked; or where something stands still."""
    t, times, expansions = motion
    at[:] = 0.0
    if i >= len(times):
        at[:2] = t.centres[i - len(times)]
        return
    since = time - t.coast[i]
    duration = times[i].sum()
    s = arc_at(times[i], duration, since)
    side = int(s > 0.5)
    _, mu, mu_s = powers_at(times[i], s)
    for axis in range(2):
        place, first, second = powers_at(expansions[i, side, axis], s - side)
        at[axis], at[2 + axis] = place, first / mu
        if since < 0.0:
            at[axis] += since * t.velocity[i, axis]
        elif since < duration:
            at[4 + axis] = acceleration(mu, mu_s, first, second)


@compiled
def _add_slope(
    motion: tuple[Manoeuvre, Values], i: int, time: float, along: Array, row: Array
) -> None:
    """Add to `row` (P,) the slopes of `along` (2,) times robot i's position at an instant."""
    t, at = motion
    g, times, by = t.grid, at.times[i], _by_parameters(t, at.x[i], i)
    s = arc_at(times, times.sum(), time - t.coast[i])
    side, speed = int(s > 0.5), 0.0
    values = np.empty(at.ends.shape[2])
    for j in range(values.size):
        values[j] = powers_at(g.taylor[side, :, j], s - side)[0]
    for axis in range(2):
        row += along[axis] * (values @ by[axis])
        speed += along[axis] * powers_at(at.expansions[i, side, axis], s - side)[1]
    if 0.0 < s < 1.0:  # at a fixed instant the arc changes with the speed
        speed /= powers_at(times, s)[1]
        for j in range(len(g.passing)):
            row[j] -= speed * powers_at(g.passing[j], s)[0]


@compiled
def derivatives(t: Manoeuvre, at: Values, weight: float) -> tuple[Array, Array, Array, Array]:
    """
    Differentiate gas and margins by x.

    Gradient (n, P) and Hessian (n, P, P) of `weight` times the gas; the margins near active (r,),
    and their slopes (r, n, P).
    """
    g, (n, size), count, near = t.grid, at.x.shape, t.grid.weights.size, at.approaches
    most, at_nodes, r = (at.own < g.active).sum() + len(near), 2 * count, 0
    margins, rows = np.empty(most), np.zeros((most, n, size))
    gradient, hessian = np.zeros((n, size)), np.zeros((n, size, size))
    slopes_of = np.zeros((n, g.active.size, size))
    by, found = np.zeros((_LOCAL, count, size)), np.empty(_CURVATURE + _LOCAL**2)
    for i in range(n):
        if t.kept[i]:
            continue
        local, ends_by = _locals(g, at.x[i], at.ends[i]), _by_parameters(t, at.x[i], i)
        walls = slopes_of[i, at_nodes:].reshape(2, 2, len(g.places), size)
        for d in range(2):
            by[d, :, : g.slope.size] = g.rates[d]
            walls[d, 0] = g.places @ ends_by[d] / t.separation
            walls[d, 1] = -walls[d, 0]
            for axis in range(3):
                by[2 + 2 * axis + d] = g.paths[axis, d] @ ends_by[axis]
        for k in range(count):
            share = weight * g.weights[k]
            _push_with_curvature(local[k], t.thrust, t.torque, share, found)
            slopes = found[_VALUES:_CURVATURE].reshape(_LOCAL, _VALUES)
            bend = found[_CURVATURE:].reshape(_LOCAL, _LOCAL)
            here = np.ascontiguousarray(by[:, k])
            steep = slopes.T @ here
            gradient[i] += share * steep[0]
            hessian[i] += here.T @ (bend @ here)
            slopes_of[i, k], slopes_of[i, count + k] = steep[1], steep[2]
            for axis in range(2):  # the start's acceleration comes with the square of mu
                a = 2.0 * g.given[axis] * t.acceleration[i, axis]
                for d in range(2):
                    along = share * slopes[2 + 2 * axis + d, 0]
                    hessian[i, 0, 0] += a * along * g.paths[axis, d, k, 2]
    for i in range(n):
        for c in range(g.active.size):
            if at.own[i, c] < g.active[c]:
                margins[r], rows[r, i] = at.own[i, c], slopes_of[i, c]
                r += 1
    approach_rows(_add_slope, (t, at), t.varied, t.clearances, near, rows[r:], margins[r:])
    return gradient, hessian, margins, rows
