# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Compiled motion of the rotary pendulum: under arcs of torque, replayed, under a feedback law.

States are (theta, psi, theta', psi'). Arcs of constant torque are integrated by the classical
method of fourth order, with their derivatives. A replay, which must not share its errors, takes
the twelve-stage formula of Dormand and Prince (Hairer, Norsett and Wanner, "Solving Ordinary
Differential Equations I"), with the coefficients of scipy's DOP853, at steps so short that its
error is that of rounding. The feedback law is tabulated: in every interval T_k - K_k (x - r_k),
saturated, is held, as a tracker does with a plan, to look ahead to the plan's end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants import rotary_pendulum as stated
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.plants.slopes import with_slopes

if TYPE_CHECKING:
    from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_STAGES = 12
_LONGEST = 0.05  # of 1/w0: no step of a replay is longer
_FASTEST = 0.3  # rad, that no angle turns by in one of them
_MOST_PARTS = 20  # of a step that is too long
_SUBSTEPS = 2  # RK4 steps an interval of a feedback law

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


def replay_pendulum(plant: RotaryPendulum, trajectory: Trajectory, times: Array) -> Array | None:
    """
    States (n, 4) at `times` (n,), which increase, from the first state of `trajectory`.

    None where that would be inaccurate: where a held control jumps between two `times`, or where
    they are much too far apart.
    """
    if times.size < 2 or abs(times[0] - trajectory.times[0]) > 1e-12:
        return None
    steps = np.diff(times)
    fastest = float(np.abs(trajectory.states[:, 2:]).max())
    longest = min(_LONGEST / plant.natural_frequency, _FASTEST / max(fastest, 1e-9))
    parts = math.ceil(min(steps.max() / longest, 1e9))
    if parts > _MOST_PARTS:
        return None
    if parts > 1:
        shares = np.arange(parts) / parts
        finer = np.append((times[:-1, None] + steps[:, None] * shares).ravel(), times[-1])
        states = replay_pendulum(plant, trajectory, finer)
        return None if states is None else states[::parts]
    formula = dormand_prince()
    if trajectory.interpolation == 'zero_order_hold':
        if not np.isin(_switches(trajectory), times).all():
            return None
        held = trajectory.controls_at(times[:-1])
        torques = np.repeat(held, _STAGES, axis=1)
    else:
        inside = times[:-1, None] + steps[:, None] * formula[0]
        torques = trajectory.controls_at(inside.ravel()).reshape(-1, _STAGES)
    states = np.empty((times.size, 4))
    states[0] = trajectory.states[0]
    with np.errstate(all='ignore'):
        replay_steps(plant.coefficients, steps, torques, *formula[1:], states)
    return states


def _switches(trajectory: Trajectory) -> Array:
    jumps = (np.diff(trajectory.controls[:-1], axis=0) != 0).any(axis=1)
    switches: Array = trajectory.times[1:-1][jumps]
    return switches


def dormand_prince() -> tuple[Array, Array, Array]:
    """Return nodes c (12,), matrix a (12, 12), weights b (12,) of the formula."""
    from scipy.integrate import DOP853

    return DOP853.C[:_STAGES], DOP853.A[:_STAGES, :_STAGES].copy(), DOP853.B.copy()


def compile_replay(plant: RotaryPendulum) -> None:
    """Compile the kernel or load it from the disk."""
    replay_steps(
        plant.coefficients,
        np.full(1, 1e-3),
        np.zeros((1, _STAGES)),
        *dormand_prince()[1:],
        np.zeros((2, 4)),
    )


@compiled
def replay_steps(
    k: Coefficients, steps: Array, torques: Array, matrix: Array, weights: Array, states: Array
) -> None:
    """
    Fill `states` (n + 1, 4) from its first row on, over `steps` (n,) s.

    `k` are the plant's coefficients, `torques` (n, 12) those at the stages of every step.
    """
    rates, y = np.empty((12, 4)), np.empty(4)
    for node in range(steps.size):
        h = steps[node]
        for s in range(12):
            for m in range(4):
                total = 0.0
                for p in range(s):
                    total += matrix[s, p] * rates[p, m]
                y[m] = states[node, m] + h * total
            rates[s, 0], rates[s, 1] = y[2], y[3]
            rates[s, 2], rates[s, 3] = accelerations(k, y[0], y[2], y[3], torques[node, s])
        for m in range(4):
            total = 0.0
            for s in range(12):
                total += weights[s] * rates[s, m]
            states[node + 1, m] = states[node, m] + h * total


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


def compile_feedback(plant: RotaryPendulum) -> None:
    """Compile the kernel or load it from the disk."""
    table = FeedbackTable(np.zeros((1, 4)), np.zeros(1), np.zeros((1, 4)), 1e-3, 1.0)
    roll_feedback(plant, np.zeros(4), table)


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
