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
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.slopes import with_curvature, with_slopes
from tdm_planner.problems.formation.program import approach_rows, approaches, CLOSENESS
from tdm_planner.problems.formation.reference_motion import acceleration, arc_at, Grid, powers_at

Array = NDArray[np.float64]
Numbers = Sequence[Any]

_GAS_SMOOTHING = 0.03  # share of F_max by which |F| is rounded off at zero
_THRUST_SHARE = 0.99  # of F_max planned with: what lies between nodes, and repairs, need the rest
_ROUNDED = 1e-6  # of F_max, by which the margin of thrust is rounded off at zero
ACTIVE_THRUST, ACTIVE_TORQUE, ACTIVE_WALL = 0.35, 0.5, 1.0
_IRRELEVANT = 2.0  # a margin that makes no row


def push(local: Numbers, thrust: Any) -> tuple[Any, ...]:
    """
    Return the gas per arc [m/s], rounded off at zero, and the margin of thrust, 1 - F / F_max.

    `local`: mu, mu_s, x_s, x_ss, y_s, y_ss.
    """
    mu, mu_s = local[:2]
    square = acceleration(mu, mu_s, *local[2:4]) ** 2 + acceleration(mu, mu_s, *local[4:6]) ** 2
    limit = _THRUST_SHARE * thrust
    gas = np.sqrt(square + (_GAS_SMOOTHING * thrust) ** 2) * mu
    return gas, 1.0 - np.sqrt(square + (_ROUNDED * limit) ** 2) / limit


def turn(local: Numbers, torque: Any) -> tuple[Any, ...]:
    """Return the margin of torque, 1 - |T| / T_max; `local`: mu, mu_s, yaw_s, yaw_ss."""
    return (1.0 - np.abs(acceleration(*local)) / torque,)


PUSH, TURN = 6, 4  # local variables
_push = inlined(with_slopes(push, (), local=PUSH))
_push_with_curvature = inlined(with_curvature(push, ('local',), local=PUSH, weights=2))
_SLOPES = 2  # where they begin among the results
_CURVATURE = _SLOPES + 2 * PUSH
_RESULT = _CURVATURE + PUSH**2
_turn = inlined(with_slopes(turn, (), local=TURN))
_turn_with_slopes = inlined(with_slopes(turn, ('local',), local=TURN))


class Manoeuvre(NamedTuple):
    """
    One manoeuvre, as the kernels take it.

    `fixed` (n, 2, m) and `fixed_yaw` (n, my) are what is given of the end derivatives. The start's
    `velocity` and `acceleration` (n, 3) are those of x, y and yaw. Walls are at `low` and `high`
    (n, 2); clearances (N, N) as `FormationProgram` has them, of robots and of what stands still at
    the `centres` (c, 2). `kept` (n,) are not `varied`.
    """

    grid: Grid
    fixed: Array
    fixed_yaw: Array
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
    kept: NDArray[np.bool_]
    varied: NDArray[np.bool_]


class Values(NamedTuple):
    """
    What is known at one x (n, P); margins are relative to their limits, negative if violated.

    All `gas` [m/s] and the `worst` margin; `thrust`, `torque` (n, K) at the nodes, `walls`
    (n, 2, 2, W) [robot, axis, side, arc]; `approaches` (r, 6); end derivatives `position`
    (n, 2, m) and `yaw` (n, my), powers of s in the time `times` (n, q + 2), Taylor coefficients
    about both ends (n, 2, 2, m).
    """

    x: Array
    gas: float
    worst: float
    thrust: Array
    torque: Array
    walls: Array
    approaches: Array
    position: Array
    yaw: Array
    times: Array
    expansions: Array


@compiled
def unpacked(t: Manoeuvre, x: Array) -> tuple[Array, Array]:
    """End derivatives by s, (n, 2, m) and (n, my), at the varied parameters x (n, P)."""
    g, position, yaw = t.grid, t.fixed.copy(), t.fixed_yaw.copy()
    nb = g.slope.size
    for i in range(len(x)):
        mu, slope = x[i, 0], 0.0
        for k in range(nb):
            slope += g.slope[k] * x[i, k]
        first = nb
        for axis in range(3):
            end, shapes = (position[i, axis], g.shapes) if axis < 2 else (yaw[i], g.shapes_yaw)
            end[1] += mu * t.velocity[i, axis]
            departing = mu**2 * t.acceleration[i, axis] + slope * t.velocity[i, axis]
            end[2] += g.given[axis] * departing
            for j in range(end.size):
                for q in range(shapes.shape[1]):
                    end[j] += shapes[j, q] * x[i, first + q]
            first += shapes.shape[1]
    return position, yaw


@compiled
def _set_locals(g: Grid, x: Array, ends: Array, yaw: Array, k: int, at: Array) -> None:
    """Fill in mu, mu_s, then the first two derivatives of x, y and yaw at node k, (8,)."""
    at[:] = 0.0
    for d in range(2):
        for j in range(g.rates.shape[2]):
            at[d] += g.rates[d, k, j] * x[j]
        for j in range(ends.shape[1]):
            at[2 + d] += g.paths[d, k, j] * ends[0, j]
            at[4 + d] += g.paths[d, k, j] * ends[1, j]
        for j in range(yaw.size):
            at[6 + d] += g.turns[d, k, j] * yaw[j]


@compiled
def evaluate(t: Manoeuvre, x: Array, found: Array) -> Values:
    """Gas and margins at the varied parameters x (n, P); `found` (r, 6) for approaches."""
    g, n, nb = t.grid, len(x), t.grid.slope.size
    position, yaw = unpacked(t, x)
    count, m = g.weights.size, position.shape[2]
    gas, at = np.zeros(n), np.zeros(PUSH + 2)
    thrust, torque = np.full((n, count), _IRRELEVANT), np.full((n, count), _IRRELEVANT)
    walls = np.full((n, 2, 2, len(g.places)), _IRRELEVANT)
    times, expansions, last = np.zeros((n, nb + 1)), np.zeros((n, 2, 2, m)), 0.0
    for i in range(n):
        times[i] = x[i, :nb] @ g.passing
        last = max(last, t.coast[i] + times[i].sum())
        for side in range(2):
            for axis in range(2):
                expansions[i, side, axis] = g.taylor[side] @ position[i, axis]
        if t.kept[i]:
            continue
        for k in range(count):
            _set_locals(g, x[i], position[i], yaw[i], k, at)
            used, thrust[i, k] = _push(at[:PUSH], t.thrust)
            gas[i] += g.weights[k] * used
            (torque[i, k],) = _turn((at[0], at[1], at[6], at[7]), t.torque)
        for axis in range(2):
            for k in range(len(g.places)):
                place = g.places[k] @ position[i, axis]
                walls[i, axis, 0, k] = (place - t.low[i, axis]) / t.separation
                walls[i, axis, 1, k] = (t.high[i, axis] - place) / t.separation
    motion = t, times, expansions
    near = approaches(_place, motion, t.clearances, last, t.interval, found)
    worst = min(1.0, thrust.min(), torque.min(), walls.min())
    for r in range(near):
        worst = min(worst, found[r, CLOSENESS])
    return Values(
        x, gas.sum(), worst, thrust, torque, walls, found[:near], position, yaw, times, expansions
    )  # fmt: skip


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


@inlined
def _add_departure(
    t: Manoeuvre, x: Array, i: int, axis: int, first: float, second: float, row: Array
) -> None:
    """Add to `row` the slopes by b of what the start gives, by its first two derivatives."""
    v, a = t.velocity[i, axis], t.grid.given[axis] * t.acceleration[i, axis]
    row[0] += first * v + 2.0 * second * x[0] * a
    for j in range(t.grid.slope.size):
        row[j] += second * t.grid.given[axis] * t.grid.slope[j] * v


@compiled
def _add_slope(
    motion: tuple[Manoeuvre, Values], i: int, time: float, along: Array, row: Array
) -> None:
    """Add to `row` (P,) the slopes of `along` (2,) times robot i's position at an instant."""
    t, at = motion
    (m, nf), nb, times = t.grid.shapes.shape, t.grid.slope.size, at.times[i]
    s = arc_at(times, times.sum(), time - t.coast[i])
    side, speed = int(s > 0.5), 0.0
    values = np.empty(m)
    for j in range(m):
        values[j] = powers_at(t.grid.taylor[side, :, j], s - side)[0]
    for axis in range(2):
        _add_departure(t, at.x[i], i, axis, along[axis] * values[1], along[axis] * values[2], row)
        for q in range(nf):
            for j in range(m):
                row[nb + axis * nf + q] += along[axis] * values[j] * t.grid.shapes[j, q]
        speed += along[axis] * powers_at(at.expansions[i, side, axis], s - side)[1]
    if 0.0 < s < 1.0:  # at a fixed instant the arc changes with the speed
        speed /= powers_at(times, s)[1]
        for j in range(nb):
            row[j] -= speed * powers_at(t.grid.passing[j], s)[0]


@compiled
def _set_slopes(t: Manoeuvre, x: Array, i: int, k: int, by: Array) -> None:
    """Fill in the slopes (8, P) of what `_set_locals` gives."""
    g = t.grid
    nb, nf = g.slope.size, g.shapes.shape[1]
    by[:] = 0.0
    for d in range(2):
        by[d, :nb] = g.rates[d, k]
        for axis in range(3):
            row, first = by[2 + 2 * axis + d], nb + axis * nf
            last = first + nf
            if axis < 2:
                row[first:last] = g.paths_free[d, k]
                begin, bend = g.paths[d, k, 1], g.paths[d, k, 2]
            else:
                row[first:] = g.turns_free[d, k]
                begin, bend = g.turns[d, k, 1], g.turns[d, k, 2]
            _add_departure(t, x, i, axis, begin, bend, row)


@compiled
def derivatives(
    t: Manoeuvre, at: Values, weight: float, dual: Array
) -> tuple[Array, Array, Array, Array]:
    """
    Differentiate gas and margins by x.

    Gradient (n, P) of `weight` times the gas; Hessian (n, P, P) of that less `dual` (n, K) times
    the margins of thrust; the margins near active (r,), those of thrust first, and their slopes
    (r, n, P).
    """
    g, (n, size), near = t.grid, at.x.shape, at.approaches
    nb, nf = t.grid.slope.size, t.grid.shapes.shape[1]
    most = (at.thrust < ACTIVE_THRUST).sum() + (at.torque < ACTIVE_TORQUE).sum()
    most += (at.walls < ACTIVE_WALL).sum() + len(near)
    margins, rows, r = np.empty(most), np.zeros((most, n, size)), 0
    gradient, hessian = np.zeros((n, size)), np.zeros((n, size, size))
    local, by, found = np.zeros(PUSH + 2), np.zeros((PUSH + 2, size)), np.empty(_RESULT)
    weights, bent = np.empty(2), np.empty((PUSH, size))
    for i in range(n):
        if t.kept[i]:
            continue
        for k in range(g.weights.size):
            _set_locals(g, at.x[i], at.position[i], at.yaw[i], k, local)
            _set_slopes(t, at.x[i], i, k, by)
            weights[0], weights[1] = weight * g.weights[k], -dual[i, k]
            _push_with_curvature(local[:PUSH], t.thrust, weights, found)
            slopes = found[_SLOPES:_CURVATURE].reshape(PUSH, 2)
            curvature = found[_CURVATURE:].reshape(PUSH, PUSH)
            bent[:] = 0.0
            for j in range(PUSH):
                for other in range(PUSH):
                    for p in range(size - t.grid.shapes_yaw.shape[1]):
                        bent[j, p] += curvature[j, other] * by[other, p]
            for j in range(PUSH):
                for p in range(size):
                    slope = by[j, p]
                    if slope != 0.0:
                        gradient[i, p] += weights[0] * slopes[j, 0] * slope
                        for q in range(size):
                            hessian[i, p, q] += slope * bent[j, q]
            for axis in range(2):  # the start's acceleration comes with the square of mu
                a = 2.0 * t.grid.given[axis] * t.acceleration[i, axis]
                for d in range(2):
                    one, other = slopes[2 + 2 * axis + d]
                    steep = weights[0] * one + weights[1] * other
                    hessian[i, 0, 0] += a * steep * g.paths[d, k, 2]
            if at.thrust[i, k] < ACTIVE_THRUST:
                for j in range(PUSH):
                    for p in range(size):
                        rows[r, i, p] += slopes[j, 1] * by[j, p]
                margins[r] = at.thrust[i, k]
                r += 1
    for i in range(n):
        for k in range(g.weights.size):
            if at.torque[i, k] < ACTIVE_TORQUE:
                _set_locals(g, at.x[i], at.position[i], at.yaw[i], k, local)
                _set_slopes(t, at.x[i], i, k, by)
                turning = local[0], local[1], local[6], local[7]
                steep = _turn_with_slopes(turning, t.torque)[1:]
                for p in range(size):
                    rows[r, i, p] += steep[0] * by[0, p] + steep[1] * by[1, p]
                    rows[r, i, p] += steep[2] * by[6, p] + steep[3] * by[7, p]
                margins[r] = at.torque[i, k]
                r += 1
        for axis in range(2):
            for side in range(2):
                sign, first = (1.0 - 2.0 * side) / t.separation, nb + axis * nf
                last = first + nf
                for k in range(len(g.places)):
                    if at.walls[i, axis, side, k] < ACTIVE_WALL:
                        rows[r, i, first:last] = sign * g.places_free[k]
                        begin, bend = sign * g.places[k, 1], sign * g.places[k, 2]
                        _add_departure(t, at.x[i], i, axis, begin, bend, rows[r, i])
                        margins[r] = at.walls[i, axis, side, k]
                        r += 1
    approach_rows(_add_slope, (t, at), t.varied, t.clearances, near, rows[r:], margins[r:])
    return gradient, hessian, margins, rows
