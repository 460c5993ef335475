# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

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
from tdm_planner.plants import rotary_pendulum as stated
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.plants.slopes import with_slopes

Array = NDArray[np.float64]

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
    sensitivities: Array,
    with_sensitivities: bool,
) -> None:
    """
    Integrate by RK4, `steps` steps an arc; fill states (n, 4) and sensitivities (n, 4, K).

    n = K steps + 1. The sensitivities are the exact derivatives of the discrete states by the K
    durations.
    """
    arcs = durations.size
    rates, slopes = np.empty((4, 4)), np.empty((4, 6))
    dx = np.empty((4, 4))
    for m in range(4):
        states[0, m] = start[m]
    if with_sensitivities:
        sensitivities[0] = 0.0
    node = 0
    for arc in range(arcs):
        h, torque = durations[arc] / steps, torques[arc]
        for _ in range(steps):
            theta, theta_dot, psi_dot = states[node, 0], states[node, 2], states[node, 3]
            for s in range(4):
                reach = 0.0 if s == 0 else (0.5 * h if s < 3 else h)
                before = max(s - 1, 0)
                w, v = theta_dot, psi_dot
                angle = theta
                if s > 0:
                    angle += reach * rates[before, 0]
                    w += reach * rates[before, 2]
                    v += reach * rates[before, 3]
                rates[s, 0], rates[s, 1] = w, v
                (
                    rates[s, 2], rates[s, 3], slopes[s, 0], slopes[s, 1], slopes[s, 2],
                    slopes[s, 3], slopes[s, 4], slopes[s, 5],
                ) = accelerations_with_slopes(k, angle, w, v, torque)  # fmt: skip
            for m in range(4):
                states[node + 1, m] = states[node, m] + h / 6.0 * (
                    rates[0, m] + 2.0 * rates[1, m] + 2.0 * rates[2, m] + rates[3, m]
                )
            if with_sensitivities:
                _roll_sensitivities(sensitivities, node, arc, arcs, h, steps, rates, slopes, dx)
            node += 1


@compiled
def _roll_sensitivities(
    sensitivities: Array,
    node: int,
    arc: int,
    arcs: int,
    h: float,
    steps: int,
    rates: Array,
    slopes: Array,
    dx: Array,
) -> None:
    """One RK4 step of the sensitivities; the present arc's duration stretches the step itself."""
    for p in range(arcs):
        if p > arc:
            for m in range(4):
                sensitivities[node + 1, m, p] = 0.0
            continue
        stretch = 1.0 / steps if p == arc else 0.0
        x0, x2, x3 = (
            sensitivities[node, 0, p],
            sensitivities[node, 2, p],
            sensitivities[node, 3, p],
        )
        for s in range(4):
            y0, y2, y3 = x0, x2, x3
            if s > 0:
                e = 0.5 if s < 3 else 1.0
                y0 += e * (h * dx[s - 1, 0] + stretch * rates[s - 1, 0])
                y2 += e * (h * dx[s - 1, 2] + stretch * rates[s - 1, 2])
                y3 += e * (h * dx[s - 1, 3] + stretch * rates[s - 1, 3])
            dx[s, 0], dx[s, 1] = y2, y3
            dx[s, 2] = slopes[s, 0] * y0 + slopes[s, 2] * y2 + slopes[s, 4] * y3
            dx[s, 3] = slopes[s, 1] * y0 + slopes[s, 3] * y2 + slopes[s, 5] * y3
        for m in range(4):
            sensitivities[node + 1, m, p] = (
                sensitivities[node, m, p]
                + h / 6.0 * (dx[0, m] + 2.0 * dx[1, m] + 2.0 * dx[2, m] + dx[3, m])
                + stretch
                / 6.0
                * (rates[0, m] + 2.0 * rates[1, m] + 2.0 * rates[2, m] + rates[3, m])
            )


def roll_states(
    plant: RotaryPendulum, start: Array, intervals: Array, torques: Array, steps: int
) -> Array:
    """Integrate over `intervals` [s] under held `torques`, both (n,): states (n + 1, 4)."""
    nodes, unused = np.empty((intervals.size * steps + 1, 4)), np.empty((1, 4, 1))
    roll_arcs(plant.coefficients, start, intervals, torques, steps, nodes, unused, False)
    return nodes[::steps].copy()


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
    roll_states(plant, np.zeros(4), np.full(1, 1e-3), np.zeros(1), 1)
    least_peak(plant.coefficients, np.zeros(4), 1.0, 0.0, 1.0, 1.0)
