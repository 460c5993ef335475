# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
A robot's motion as a rounded polyline, compiled: burns, their slopes, what the thruster needs.

Gas is an L1 cost, whose optimum is burn - coast - burn: straight legs, and corners rounded by full
thrust. Burn k changes the velocity by p_k about the instant tau_k, from tau_k - h_k to
tau_k + h_k, h_k = |p_k| / (2 F). The position is S + v_0 t + sum_k p_k r(t - tau_k; h_k) with
r = 0 before the burn, (u + h)^2 / (4 h) in it and u after it; gas is sum_k |p_k|, exactly.

Varied parameters of a robot with m burns: the start c of the first, the corners W_k and their
instants tau_k (k = 2 ... m-1), the arrival T. The ends hold exactly: with D the way of the first
(last) leg, sigma its time and s = sqrt(sigma^2 - 2 |D| / F) the burn's h is (sigma - s) / 2 and
its |p| is |D| / g, g = (sigma + s) / 2.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, Final, NamedTuple

import numpy as np
from tdm_planner.arrays import Array, Mask
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.slopes import with_slopes
from tdm_planner.problems.formation.program import approach_rows, approaches

X, Y, CENTRE, HALF = 0, 1, 2, 3  # columns of burns: p [m/s], tau, h [s]
ALIGNED: Final = 0.01  # rad by which the thruster may turn on while it burns
WEAKEST: Final = 0.3  # of `speed`: burns that change the velocity less need no direction
_ROUNDED: Final = 0.88  # of a pause: shorter legs are continued with their slope
_TINY: Final = 1e-12
_STEP: Final = 1e-6  # of a unit, in which slopes are differenced
_NEAR: Final = 0.3  # own margins below which they make a row


class Fleet(NamedTuple):
    """
    The robots, as the kernels take them.

    `start`, `velocity` (N, 2) of the n robots, then of what stands still, with `clearances` (N, N)
    from one another, zero where they do not count, and the burns `held` (N, m, 4) of what is not
    varied. `goal` (n, 2); `alpha` (n,) NaN where free, `yaw`, `yaw_rate`, `goal_yaw` (n,);
    `varied` (n,) those whose motion is varied. `thrust` F [m/s^2], `rate` of the thruster [rad/s].
    `pause` [s] is the shortest coast, `speed` [m/s] what rounds |p| off at zero, `length` [m] and
    `time` [s] the units of the parameters; approaches are looked for between instants `interval` s
    apart.
    """

    start: Array
    velocity: Array
    clearances: Array
    held: Array
    goal: Array
    alpha: Array
    yaw: Array
    yaw_rate: Array
    goal_yaw: Array
    varied: Mask
    thrust: float
    rate: float
    pause: float
    speed: float
    length: float
    time: float
    interval: float


class ArcValues(NamedTuple):
    """
    What is known at one x (n, v): all gas [m/s], rounded off at zero, and the worst margin.

    Burns (N, m, 4) and their slopes (n, m, 4, v), `own` margins (n, m), approaches (r, 6).
    """

    x: Array
    burns: Array
    slopes: Array
    own: Array
    approaches: Array
    gas: float
    worst: float


@compiled
def turning(duration: float, way: float, rate: float) -> tuple[float, float]:
    """Angular acceleration a until an instant, -a after it: the least that turns by `way`."""
    short = duration * rate - 2.0 * way
    both = math.hypot(short, duration * rate)
    a = -(short + math.copysign(both, short)) / (duration * duration)
    return a, 0.5 * duration if a == 0.0 else 0.5 * (duration - rate / a)


@compiled
def attitude(
    t: float, duration: float, a: float, switch: float, yaw: float, rate: float, goal: float
) -> float:
    """Yaw at `t` of the turn that `turning` gives."""
    if t <= switch:
        return yaw + t * (rate + 0.5 * a * t)
    left = max(duration - t, 0.0)
    return goal - 0.5 * a * left * left


def end_leg(leg: Sequence[Any], at: Sequence[Any]) -> tuple[Any, ...]:
    """
    Return the velocity of a leg that ends or begins at rest, and half of the burn there [s].

    `leg`: its way and time; `at`: thrust and pause. Where no time is left to coast, the coast is
    continued with its slope.
    """
    x, y, sigma = leg
    thrust, pause = at
    length = np.sqrt(x * x + y * y + _TINY)
    least = _ROUNDED * pause
    square = sigma * sigma - 2.0 * length / thrust
    coast = np.sqrt(0.5 * (square + least * least + np.abs(square - least * least)))
    coast = 0.5 * (coast + square / coast)
    g = 0.5 * (sigma + coast)
    return x / g, y / g, 0.5 * (sigma - coast)


_leg_slopes = inlined(with_slopes(end_leg, ('leg',), leg=3, at=2))


@compiled
def round_off(x: Array, fleet: Fleet, i: int, burns: Array, slopes: Array) -> None:
    """Burns (m, 4) of robot i and their slopes (m, 4, v) by its varied parameters x (v,)."""
    m, v = burns.shape[0], x.size
    start, velocity, goal = fleet.start[i], fleet.velocity[i], fleet.goal[i]
    # Velocities of the legs, and half of the burn at rest of the first one and of the last;
    # values of `end_leg`, then their slopes by x, by y and by the time.
    legs, by = np.zeros((m + 1, 3)), np.zeros((m + 1, 3, v))
    slopes[:] = 0.0
    w, last = v - 4, m - 1  # of the last corner, W, tau and T are x[w:]
    way = x[1] - start[0] - velocity[0] * x[3], x[2] - start[1] - velocity[1] * x[3]
    left, at = (goal[0] - x[w], goal[1] - x[w + 1]), (fleet.thrust, fleet.pause)
    begun = _leg_slopes((*way, x[3] - x[0]), at)
    ended = _leg_slopes((*left, x[w + 3] - x[w + 2]), at)
    for a in range(3):
        legs[1, a], legs[last, a] = begun[a], ended[a]
        first, final, by_time = by[1, a], by[last, a], begun[9 + a]
        first[0], first[1], first[2] = -by_time, begun[3 + a], begun[6 + a]
        first[3] = by_time - begun[3 + a] * velocity[0] - begun[6 + a] * velocity[1]
        final[w], final[w + 1] = -ended[3 + a], -ended[6 + a]
        final[w + 2], final[w + 3] = -ended[9 + a], ended[9 + a]
    for a in range(2):
        legs[0, a] = velocity[a]
        legs[1, a] += velocity[a]
    burns[0, HALF], burns[last, HALF] = legs[1, 2], legs[last, 2]
    burns[0, CENTRE], burns[last, CENTRE] = x[0] + legs[1, 2], x[w + 3] - legs[last, 2]
    for q in range(v):
        slopes[0, HALF, q] = slopes[0, CENTRE, q] = by[1, 2, q]
        slopes[last, HALF, q], slopes[last, CENTRE, q] = by[last, 2, q], -by[last, 2, q]
    slopes[0, CENTRE, 0] += 1.0
    slopes[last, CENTRE, w + 3] += 1.0
    # Legs between two corners.
    for k in range(2, last):
        w = 3 * k - 5
        time = max(x[w + 5] - x[w + 2], 1.25 * fleet.pause)
        for a in range(2):
            legs[k, a] = (x[w + 3 + a] - x[w + a]) / time
            by[k, a, w + 3 + a], by[k, a, w + a] = 1.0 / time, -1.0 / time
            by[k, a, w + 5], by[k, a, w + 2] = -legs[k, a] / time, legs[k, a] / time
    for k in range(m):
        for a in range(2):
            burns[k, a] = legs[k + 1, a] - legs[k, a]
            for q in range(v):
                slopes[k, a, q] = by[k + 1, a, q] - by[k, a, q]
    for k in range(1, last):
        size = math.sqrt(burns[k, X] ** 2 + burns[k, Y] ** 2 + _TINY)
        burns[k, CENTRE], burns[k, HALF] = x[3 * k], 0.5 * size / fleet.thrust
        slopes[k, CENTRE, 3 * k] = 1.0
        for q in range(v):
            along = burns[k, X] * slopes[k, X, q] + burns[k, Y] * slopes[k, Y, q]
            slopes[k, HALF, q] = 0.5 * along / (size * fleet.thrust)


@compiled
def _place(motion: tuple[Fleet, Array], i: int, t: float, found: Array) -> None:
    """Fill in position, velocity and acceleration of the i-th at `t`, (6,)."""
    fleet, burns = motion
    for a in range(2):
        found[a] = fleet.start[i, a] + fleet.velocity[i, a] * t
        found[2 + a], found[4 + a] = fleet.velocity[i, a], 0.0
    for k in range(burns.shape[1]):
        u, h = t - burns[i, k, CENTRE], burns[i, k, HALF]
        if u <= -h:
            continue
        if u >= h:
            r, rate, bend = u, 1.0, 0.0
        else:
            r, rate, bend = (u + h) ** 2 / (4.0 * h), (u + h) / (2.0 * h), 0.5 / h
        for a in range(2):
            found[a] += burns[i, k, a] * r
            found[2 + a] += burns[i, k, a] * rate
            found[4 + a] += burns[i, k, a] * bend


@compiled
def _add_slope(motion: ArcValues, i: int, t: float, along: Array, row: Array) -> None:
    """Add to `row` (v,) the slopes of `along` (2,) times the position of the i-th at `t`."""
    burns, slopes = motion.burns[i], motion.slopes[i]
    for k in range(burns.shape[0]):
        u, h = t - burns[k, CENTRE], burns[k, HALF]
        if u <= -h:
            continue
        r, rate, by_half = u, 1.0, 0.0
        if u < h:
            r, rate = (u + h) ** 2 / (4.0 * h), (u + h) / (2.0 * h)
            by_half = (h * h - u * u) / (4.0 * h * h)
        p = along[0] * burns[k, X] + along[1] * burns[k, Y]
        for q in range(row.size):
            row[q] += (along[0] * slopes[k, X, q] + along[1] * slopes[k, Y, q]) * r
            row[q] += p * (by_half * slopes[k, HALF, q] - rate * slopes[k, CENTRE, q])


@compiled
def positions(times: Array, fleet: Fleet, i: int, burns: Array) -> Array:
    """Positions (K, 2) of the i-th at `times` (K,), by burns (N, m, 4)."""
    found, at = np.zeros((times.size, 2)), np.zeros(6)
    for k in range(times.size):
        _place((fleet, burns), i, times[k], at)
        found[k, 0], found[k, 1] = at[0], at[1]
    return found


@compiled
def own_margins(x: Array, fleet: Fleet, i: int, burns: Array, margins: Array) -> None:
    """Coasts of robot i before every burn (m,), less what the thruster needs to turn."""
    m, duration = burns.shape[0], x[x.size - 1]
    a, switch = turning(duration, fleet.goal_yaw[i] - fleet.yaw[i], fleet.yaw_rate[i])
    angle, since = fleet.alpha[i], 0.0  # of the thruster, and since when it may turn
    end, pause = 0.0, 0.0
    for k in range(m):
        half = burns[k, HALF]
        begin = burns[k, CENTRE] - half
        gap = begin - end - pause
        if math.hypot(burns[k, X], burns[k, Y]) > WEAKEST * fleet.speed or k == m - 1:
            heading = math.atan2(burns[k, Y], burns[k, X])
            yaw = fleet.yaw[i], fleet.yaw_rate[i], fleet.goal_yaw[i]
            if not math.isnan(angle):
                away = heading - attitude(begin, duration, a, switch, *yaw) - angle
                away -= 2.0 * math.pi * math.floor((away + math.pi) / (2.0 * math.pi))
                gap = min(gap, begin - since - (abs(away) - ALIGNED) / fleet.rate)
            since = begin + 2.0 * half
            angle = heading - attitude(since, duration, a, switch, *yaw)
        margins[k] = 2.0 * gap / fleet.time
        if half < 0.0:
            margins[k] = min(margins[k], 2.0 * (half - fleet.pause) / fleet.time)
        end, pause = begin + 2.0 * half, fleet.pause


@compiled
def _gas_slopes(fleet: Fleet, burns: Array, slopes: Array, gradient: Array) -> None:
    gradient[:] = 0.0
    for k in range(burns.shape[0]):
        size = math.sqrt(burns[k, X] ** 2 + burns[k, Y] ** 2 + fleet.speed**2)
        for q in range(gradient.size):
            along = burns[k, X] * slopes[k, X, q] + burns[k, Y] * slopes[k, Y, q]
            gradient[q] += along / size


@compiled
def evaluate(fleet: Fleet, x: Array) -> ArcValues:
    """Burns, own margins and approaches at the parameters x (n, v)."""
    (n, v), m = x.shape, fleet.held.shape[1]
    burns, slopes, margins = fleet.held.copy(), np.zeros((n, m, 4, v)), np.ones((n, m))
    last, gas = 0.0, 0.0
    for i in range(n):
        last = max(last, x[i, v - 1])
        if not fleet.varied[i]:
            continue
        round_off(x[i], fleet, i, burns[i], slopes[i])
        for k in range(m):
            size = math.sqrt(burns[i, k, X] ** 2 + burns[i, k, Y] ** 2 + fleet.speed**2)
            gas += size - fleet.speed
        own_margins(x[i], fleet, i, burns[i], margins[i])
    motion = fleet, burns
    near, worst = approaches(_place, motion, fleet.clearances, last, fleet.interval)
    return ArcValues(x, burns, slopes, margins, near, gas, min(worst, margins.min()))


@compiled
def derivatives(fleet: Fleet, at: ArcValues, weight: float) -> tuple[Array, Array, Array, Array]:
    """
    Differentiate gas and margins by x.

    Gradient (n, v) and Hessian (n, v, v) of `weight` times the gas; the margins of approaches,
    then own ones near active (r,), and their slopes (r, n, v). The Hessian differences the exact
    gradient, and so are the own margins.
    """
    (n, v), m, near = at.x.shape, fleet.held.shape[1], at.approaches
    count, most = len(near), len(near) + at.own.size
    margins, rows = np.zeros(most), np.zeros((most, n, v))
    gradient, hessian = np.zeros((n, v)), np.zeros((n, v, v))
    burns, slopes = np.zeros((m, 4)), np.zeros((m, 4, v))
    first, second = np.zeros((2, v)), np.zeros((2, m))
    by = np.zeros((m, v))
    approach_rows(_add_slope, at, fleet.varied, fleet.clearances, near, rows, margins)
    for i in range(n):
        if not fleet.varied[i]:
            continue
        _gas_slopes(fleet, at.burns[i], at.slopes[i], gradient[i])
        x = at.x[i].copy()
        for q in range(v):
            position = q % 3 != 0 and q < v - 1
            step = _STEP * (fleet.length if position else fleet.time)
            for side in range(2):
                x[q] = at.x[i, q] + (step if side else -step)
                round_off(x, fleet, i, burns, slopes)
                _gas_slopes(fleet, burns, slopes, first[side])
                own_margins(x, fleet, i, burns, second[side])
            x[q] = at.x[i, q]
            hessian[i, :, q] = 0.5 * (first[1] - first[0]) / step
            by[:, q] = 0.5 * (second[1] - second[0]) / step
        hessian[i] = 0.5 * (hessian[i] + hessian[i].T)
        for k in range(m):
            if at.own[i, k] < _NEAR:
                margins[count], rows[count, i] = at.own[i, k], by[k]
                count += 1
    return weight * gradient, weight * hessian, margins[:count], rows[:count]
