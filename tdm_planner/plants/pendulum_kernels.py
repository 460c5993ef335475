# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled motion of the rotary pendulum: under arcs of torque, under a feedback law.

States are (theta, psi, theta', psi'). Arcs of constant torque are integrated by the classical
method of fourth order, with their derivatives. The feedback law is tabulated: in every interval
T_k - K_k (x - r_k), saturated, is held, as a tracker does with a plan, to look ahead to its end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from tdm_planner.plants import rotary_pendulum as stated
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.plants.slopes import with_slopes

Array = NDArray[np.float64]

_STAGES, _WEIGHTS = np.ascontiguousarray(DOP853.A), np.ascontiguousarray(DOP853.B)
_LONG_STEP = 0.1  # of `quick_time`
_MOST_SUBSTEPS = 10_000  # of an interval: a light disk may turn however fast
_SUBSTEPS = 2  # RK4 steps an interval of a feedback law
_SWITCHES = 24  # intervals of the grid of either switch of the torque that turns the disk least

inlined(stated.mechanics)
accelerations = inlined(stated.accelerations)


@compiled
def sine_and_cosine(angle: float) -> tuple[float, float]:
    """
    Both to the last bit or nearly, up to some 1e6 rad, without a branch.

    The angle less the nearest multiple of pi / 2, itself in three parts (Cody and Waite), then
    the polynomials of fdlibm's kernels.
    """
    quarters = np.floor(angle * 0.6366197723675814 + 0.5)
    x = angle - quarters * 1.57079632673412561417
    x -= quarters * 6.07710050630396597660e-11
    x -= quarters * 2.02226624879595063154e-21
    z = x * x
    s = 2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155e-10)
    s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * s)
    s = x + x * z * (-1.66666666666666324348e-01 + z * s)
    c = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.135964755778819e-11)
    c = -1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * c)
    c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * c)
    half = 0.5 * quarters
    odd = half > np.floor(half)
    quarter = 0.5 * np.floor(half)
    sign = 1.0 - 4.0 * (quarter - np.floor(quarter))
    return sign * (c if odd else s), sign * (-s if odd else c)


@inlined
def _sine(angle: float) -> float:
    return sine_and_cosine(angle)[0]


@inlined
def _cosine(angle: float) -> float:
    return sine_and_cosine(angle)[1]


def _written(*by: str) -> Callable[..., Any]:
    return inlined(with_slopes(stated.accelerations, by, _sine, _cosine, k=Coefficients))


quick_accelerations = _written()
accelerations_with_slopes = _written('theta', 'theta_dot', 'psi_dot')


@inlined
def runge_kutta(
    k: Coefficients, theta: float, psi: float, w: float, v: float, torque: float, h: float
) -> tuple[float, float, float, float]:
    """Return theta, psi, theta', psi' after one classical step of `h` s under a held torque."""
    a1, c1 = quick_accelerations(k, theta, w, v, torque)
    w2, v2 = w + 0.5 * h * a1, v + 0.5 * h * c1
    a2, c2 = quick_accelerations(k, theta + 0.5 * h * w, w2, v2, torque)
    w3, v3 = w + 0.5 * h * a2, v + 0.5 * h * c2
    a3, c3 = quick_accelerations(k, theta + 0.5 * h * w2, w3, v3, torque)
    w4, v4 = w + h * a3, v + h * c3
    a4, c4 = quick_accelerations(k, theta + h * w3, w4, v4, torque)
    return (
        theta + h / 6.0 * (w + 2.0 * (w2 + w3) + w4),
        psi + h / 6.0 * (v + 2.0 * (v2 + v3) + v4),
        w + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4),
        v + h / 6.0 * (c1 + 2.0 * (c2 + c3) + c4),
    )


@compiled
def roll_arcs(
    k: Coefficients,
    start: Array,
    durations: Array,
    torques: Array,
    steps: int,
    states: Array,
    within: Array,
    begins: Array,
) -> None:
    """
    Integrate K arcs by RK4, `steps` steps each; the exact derivatives of the discrete states.

    Filled are `states` (n, 4), n = K steps + 1; `within` (n, 4, 4), their derivatives by theta,
    theta', psi' at the beginning of the arc that ends there or goes on, and by its duration; and
    `begins` (K + 1, 4, K), those by the durations at the beginning of every arc and at the end.
    """
    rates, slopes, x, stretch = np.empty((4, 4)), np.empty((4, 6)), np.empty(16), np.zeros(4)
    states[0], begins[0], within[0] = start, 0.0, 0.0
    stretch[3] = 1.0 / steps
    node = 0
    for arc in range(durations.size):
        h, torque = durations[arc] / steps, torques[arc]
        x[:] = 0.0
        x[0] = x[9] = x[14] = 1.0
        for _ in range(steps):
            theta, w, v = states[node, 0], states[node, 2], states[node, 3]
            _rates(k, theta, w, v, torque, rates[0], slopes[0])
            for s in range(1, 4):
                r, reach = rates[s - 1], h if s == 3 else 0.5 * h
                angle, u = theta + reach * r[0], w + reach * r[2]
                _rates(k, angle, u, v + reach * r[3], torque, rates[s], slopes[s])
            for m in range(4):
                rate = rates[0, m] + 2.0 * (rates[1, m] + rates[2, m]) + rates[3, m]
                states[node + 1, m] = states[node, m] + h / 6.0 * rate
            node += 1
            _roll_columns(x, h, stretch, rates.ravel(), slopes.ravel())
            for m in range(4):
                for c in range(4):
                    within[node, m, c] = x[4 * m + c]
        now, then, later = begins[arc], begins[arc + 1], arc + 1
        for m in range(4):
            a, b, c = x[4 * m], x[4 * m + 1], x[4 * m + 2]
            for p in range(arc):
                then[m, p] = a * now[0, p] + b * now[2, p] + c * now[3, p]
            then[m, arc], then[m, later:] = x[4 * m + 3], 0.0
        for p in range(arc):
            then[1, p] += now[1, p]


@inlined
def _rates(
    k: Coefficients, theta: float, w: float, v: float, torque: float, rates: Array, slopes: Array
) -> None:
    """Fill the rates of the states, and the slopes of the accelerations."""
    rates[0], rates[1] = w, v
    rates[2], rates[3], slopes[0], slopes[1], slopes[2], slopes[3], slopes[4], slopes[5] = (
        accelerations_with_slopes(k, theta, w, v, torque)
    )


@compiled
def derivative(within: Array, begins: Array, node: int, arc: int, m: int, p: int) -> float:
    """Return the derivative of state `m` at a node of an arc by the duration of arc `p`."""
    if p >= arc:
        return float(within[node, m, 3]) if p == arc else 0.0
    carried = within[node, m, 0] * begins[arc, 0, p]
    carried += within[node, m, 1] * begins[arc, 2, p] + within[node, m, 2] * begins[arc, 3, p]
    return float(carried + begins[arc, 1, p]) if m == 1 else float(carried)


@compiled
def _roll_columns(x: Array, h: float, stretch: Array, r: Array, g: Array) -> None:
    """
    One RK4 step of four derivatives of the states, the columns of `x` (16,).

    `r` (16,) are the rates at its stages, `g` (24,) the slopes of the accelerations. By the
    present arc's duration, times `stretch` (4,), the step itself grows.
    """
    for c in range(4):
        half, sixth, s = 0.5 * h, h / 6.0, stretch[c]
        t1, w1, v1 = x[c], x[8 + c], x[12 + c]
        a1 = g[0] * t1 + g[2] * w1 + g[4] * v1
        b1 = g[1] * t1 + g[3] * w1 + g[5] * v1
        e = 0.5 * s
        t2, w2, v2 = (
            t1 + half * w1 + e * r[0],
            w1 + half * a1 + e * r[2],
            v1 + half * b1 + e * r[3],
        )
        a2 = g[6] * t2 + g[8] * w2 + g[10] * v2
        b2 = g[7] * t2 + g[9] * w2 + g[11] * v2
        t3, w3, v3 = (
            t1 + half * w2 + e * r[4],
            w1 + half * a2 + e * r[6],
            v1 + half * b2 + e * r[7],
        )
        a3 = g[12] * t3 + g[14] * w3 + g[16] * v3
        b3 = g[13] * t3 + g[15] * w3 + g[17] * v3
        t4, w4, v4 = t1 + h * w3 + s * r[8], w1 + h * a3 + s * r[10], v1 + h * b3 + s * r[11]
        a4 = g[18] * t4 + g[20] * w4 + g[22] * v4
        b4 = g[19] * t4 + g[21] * w4 + g[23] * v4
        e = s / 6.0
        x[c] = t1 + sixth * (w1 + 2.0 * (w2 + w3) + w4)
        x[4 + c] += sixth * (v1 + 2.0 * (v2 + v3) + v4)
        x[8 + c] = w1 + sixth * (a1 + 2.0 * (a2 + a3) + a4)
        x[12 + c] = v1 + sixth * (b1 + 2.0 * (b2 + b3) + b4)
        for m in range(4):
            x[4 * m + c] += e * (r[m] + 2.0 * (r[4 + m] + r[8 + m]) + r[12 + m])


@inlined
def quick_time(k: Coefficients, theta: float, w: float, v: float) -> float:
    """
    Time scale of the motion about a state [s], which steps are to be a share of.

    With D the determinant of the mass matrix: that of small swings where the disk turns at psi'
    and with them, and the time in which D, by which everything is divided, changes.
    """
    sine, cosine = sine_and_cosine(theta)
    j = k.disk + k.disk_sine * sine * sine + k.disk_cosine * cosine * cosine
    bend = k.pendulum * (k.disk_sine - k.disk_cosine) + k.arm * k.arm
    determinant = k.pendulum * j - k.arm * k.arm * cosine * cosine
    pull = j * (k.gravity + abs(k.coupling) * v * v) + abs(bend) * w * w
    return math.sqrt(determinant / pull)


@compiled
def _step_of_eighth_order(
    k: Coefficients, x: Array, torque: float, h: float, rates: Array
) -> None:
    """Advance `x` (4,) by one step of Dormand and Prince's method; `rates` (12, 4) is scratch."""
    for s in range(12):
        theta, w, v = x[0], x[2], x[3]
        for j in range(s):
            a = h * _STAGES[s, j]
            theta, w, v = theta + a * rates[j, 0], w + a * rates[j, 2], v + a * rates[j, 3]
        rates[s, 0], rates[s, 1] = w, v
        rates[s, 2], rates[s, 3] = quick_accelerations(k, theta, w, v, torque)
    for s in range(12):
        for m in range(4):
            x[m] += h * _WEIGHTS[s] * rates[s, m]


@compiled
def _roll_states(
    k: Coefficients, start: Array, intervals: Array, torques: Array, states: Array
) -> None:
    x, rates = start.copy(), np.empty((12, 4))
    states[0] = start
    for n in range(intervals.size):
        left = intervals[n]
        for _ in range(_MOST_SUBSTEPS):
            h = min(left, _LONG_STEP * quick_time(k, x[0], x[2], x[3]))
            _step_of_eighth_order(k, x, torques[n], h, rates)
            left -= h
            if not left > 0.0:
                break
        states[n + 1] = x


def roll_states(plant: RotaryPendulum, start: Array, intervals: Array, torques: Array) -> Array:
    """
    Integrate over `intervals` [s] under held `torques`, both (n,): states (n + 1, 4).

    To some ten digits: by a method of order 8, in steps that follow the motion's time scale.
    """
    states = np.empty((intervals.size + 1, 4))
    _roll_states(plant.coefficients, start, intervals, torques, states)
    return states


@dataclass(frozen=True, eq=False)
class FeedbackTable:
    """
    References (n, 4), torques (n,) [N m] and gains (n, 4), one an interval of `step` s.

    The torque is saturated at `limit` [N m].
    """

    references: Array
    torques: Array
    gains: Array
    step: float
    limit: float


def roll_feedback(plant: RotaryPendulum, start: Array, table: FeedbackTable) -> Array:
    """States (n + 1, 4) at the ends of the table's intervals, from `start` (4,)."""
    states = np.empty((len(table.torques) + 1, 4))
    with np.errstate(all='ignore'):
        _roll(
            plant.coefficients,
            np.ascontiguousarray(start, dtype=float),
            np.ascontiguousarray(table.references),
            np.ascontiguousarray(table.torques),
            np.ascontiguousarray(table.gains),
            table.limit,
            table.step / _SUBSTEPS,
            states,
        )
    return states


@compiled
def _roll(
    k: Coefficients,
    start: Array,
    references: Array,
    torques: Array,
    gains: Array,
    limit: float,
    h: float,
    states: Array,
) -> None:
    x = start.copy()
    states[0] = x
    for interval in range(torques.size):
        away = (x[0] - references[interval, 0] + math.pi) % (2.0 * math.pi) - math.pi
        torque = torques[interval] - gains[interval, 0] * away
        for m in range(1, 4):
            torque -= gains[interval, m] * (x[m] - references[interval, m])
        torque = min(max(torque, -limit), limit)
        for _ in range(_SUBSTEPS):
            x[0], x[1], x[2], x[3] = runge_kutta(k, x[0], x[1], x[2], x[3], torque, h)
        states[interval + 1] = x


@compiled
def least_peak(
    k: Coefficients, start: Array, torque: float, horizon: float, h: float, limit: float
) -> float:
    """
    Return the least |psi| [rad] found that is not exceeded for `horizon` [s] from `start` (4,).

    Tried are +-`torque` [N m] with two switches, each at any of 25 instants, denser at first; the
    search ends where a peak is below `limit` [rad]. The midpoint rule takes steps of `h` s.
    """
    best = np.inf
    for first in range(_SWITCHES + 1):
        one = (first / _SWITCHES) ** 2 * horizon
        for second in range(first, _SWITCHES + 1):
            other = one + ((second - first) / _SWITCHES) ** 1.5 * horizon
            for sign in (-1.0, 1.0):
                theta, psi, w, v = start[0], start[1], start[2], start[3]
                time, peak = 0.0, abs(psi)
                while time < horizon and peak < best:
                    held = -sign * torque if one <= time < other else sign * torque
                    a, c = quick_accelerations(k, theta, w, v, held)
                    w_mid, v_mid = w + 0.5 * h * a, v + 0.5 * h * c
                    a, c = quick_accelerations(k, theta + 0.5 * h * w, w_mid, v_mid, held)
                    theta, psi = theta + h * w_mid, psi + h * v_mid
                    w, v = w + h * a, v + h * c
                    time += h
                    peak = max(peak, abs(psi)) if abs(psi) < np.inf else np.inf
                best = min(best, peak)
                if best <= limit:
                    return float(best)
    return float(best)


def compile_kernels(plant: RotaryPendulum) -> None:
    """Compile the kernels or load them from the disk."""
    table = FeedbackTable(np.zeros((1, 4)), np.zeros(1), np.zeros((1, 4)), 1e-3, 1.0)
    roll_feedback(plant, np.zeros(4), table)
    roll_states(plant, np.zeros(4), np.full(1, 1e-3), np.zeros(1))
    least_peak(plant.coefficients, np.zeros(4), 1.0, 0.0, 1.0, 1.0)
