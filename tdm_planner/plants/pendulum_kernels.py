# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Compiled motion of the rotary pendulum: under arcs of torque, under a feedback law.

States are (theta, psi, theta', psi'). Arcs of constant torque are integrated by the classical
method of fourth order, with their derivatives: of one motion, or of many side by side for the
vector units of the processor. For these the quantities of all `LANES` motions stand in one flat
array, `row * LANES + lane`, and `LANES` is a constant: so the compiler sees that rows do not
overlap and turns every loop over lanes into vector instructions. What a lane computes does not
depend on the others.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from tdm_planner.arrays import Array, Integers
from tdm_planner.plants import rotary_pendulum as stated
from tdm_planner.plants.compilation import compiled, inlined, sine_and_cosine
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.plants.slopes import with_slopes

LANES = 16  # with 8 the compiler unrolls the loops instead
STATE = 4 * LANES
PSI, THETA_DOT, PSI_DOT = LANES, 2 * LANES, 3 * LANES
HELD, STEP = 4 * LANES, 5 * LANES  # behind the state: torque, duration of a step
_SUBSTEPS = 2  # RK4 steps an interval of a feedback law
_STEPS_OF_MOTION = 1_000_000  # at most: the disk of some rigs turns in no time
MOST_STEPS, ALL = 1000, 1.0 - 1e-9  # of an arc; share of what is left that counts as all of it


@inlined
def _sine(angle: float) -> float:
    return sine_and_cosine(angle)[0]


@inlined
def _cosine(angle: float) -> float:
    return sine_and_cosine(angle)[1]


def _written(function: Any, *by: str) -> Any:
    return inlined(with_slopes(function, by, _sine, _cosine, k=Coefficients))


quick_accelerations = _written(stated.accelerations)
runge_kutta = _written(stated.runge_kutta)
_step_with_slopes = _written(stated.runge_kutta, 'theta', 'theta_dot', 'psi_dot', 'h')


@inlined
def quick_time(k: Coefficients, theta: float, w: float, v: float) -> float:
    """
    Time scale of the motion about a state [s]; an integration step is to be a share of it.

    It is short where gravity or the disk's rate pull strongly, where damping is strong, and where
    the determinant of the mass matrix, the divisor of both accelerations, changes quickly with
    theta.
    """
    sine, cosine = sine_and_cosine(theta)
    j = k.disk + k.disk_sine * sine * sine + k.disk_cosine * cosine * cosine
    bend = k.pendulum * (k.disk_sine - k.disk_cosine) + k.arm * k.arm
    determinant = k.pendulum * j - k.arm * k.arm * cosine * cosine
    pull = j * (k.gravity + abs(k.coupling) * v * v) + abs(bend) * w * w
    stop = k.pivot_damping * j + k.disk_damping * k.pendulum
    return determinant / math.sqrt(determinant * pull + stop * stop)


@compiled
def roll_arcs(
    k: Coefficients, start: Array, durations: Array, torques: Array, counts: Integers, mesh: Array
) -> tuple[Array, Array, Array]:
    """
    Integrate K arcs by RK4 on a mesh, with the exact derivatives of the discrete states.

    An arc has `counts` (K,) steps, which are the shares `mesh` (n,) of its duration. Returns the
    states (n + 1, 4); `within` (n + 1, 4, 4), their derivatives by theta, theta', psi' at the
    beginning of the arc that ends there or goes on, and by its duration; and `begins`
    (K + 1, 4, K), those by the durations at the beginning of every arc and at the end.
    """
    arcs, node, nodes = durations.size, 0, mesh.size + 1
    states, within = np.empty((nodes, 4)), np.zeros((nodes, 4, 4))
    begins = np.zeros((arcs + 1, 4, arcs))
    states[0] = start
    for arc in range(arcs):
        x = np.zeros((4, 4))
        x[0, 0] = x[2, 1] = x[3, 2] = 1.0
        for _ in range(counts[arc]):
            (theta, psi, w, v), h = states[node], mesh[node] * durations[arc]
            (
                theta, change, w, v,
                a1, b1, c1, d1, a2, b2, c2, d2, a3, b3, c3, d3, a4, b4, c4, d4,
            ) = _step_with_slopes(k, theta, w, v, torques[arc], h)  # fmt: skip
            for c in range(4):
                by_theta, by_w, by_v = x[0, c], x[2, c], x[3, c]
                # By the duration the step itself grows.
                longer = mesh[node] if c == 3 else 0.0
                x[0, c] = a1 * by_theta + a2 * by_w + a3 * by_v + a4 * longer
                x[1, c] += b1 * by_theta + b2 * by_w + b3 * by_v + b4 * longer
                x[2, c] = c1 * by_theta + c2 * by_w + c3 * by_v + c4 * longer
                x[3, c] = d1 * by_theta + d2 * by_w + d3 * by_v + d4 * longer
            node += 1
            states[node, 0], states[node, 1], states[node, 2] = theta, psi + change, w
            states[node, 3], within[node] = v, x
        now, then = begins[arc], begins[arc + 1]
        for m in range(4):
            a, b, c = x[m, 0], x[m, 1], x[m, 2]
            for p in range(arc):
                then[m, p] = a * now[0, p] + b * now[2, p] + c * now[3, p]
            then[m, arc] = x[m, 3]
        for p in range(arc):
            then[1, p] += now[1, p]
    return states, within, begins


@compiled
def derivative(within: Array, begins: Array, node: int, arc: int, m: int, p: int) -> float:
    """Return the derivative of state `m` at a node of an arc by the duration of arc `p`."""
    if p >= arc:
        return float(within[node, m, 3]) if p == arc else 0.0
    carried = within[node, m, 0] * begins[arc, 0, p]
    carried += within[node, m, 1] * begins[arc, 2, p] + within[node, m, 2] * begins[arc, 3, p]
    return float(carried + begins[arc, 1, p]) if m == 1 else float(carried)


@compiled
def _step_lanes(k: Coefficients, x: Array, h: Array, torques: Array, columns: Array) -> None:
    """One RK4 step of all lanes, and of three derivatives of their states, the `columns`."""
    for i in range(LANES):
        theta, w, v = x[i], x[THETA_DOT + i], x[PSI_DOT + i]
        (
            theta, change, w, v,
            a1, b1, c1, d1, a2, b2, c2, d2, a3, b3, c3, d3, _, _, _, _,
        ) = _step_with_slopes(k, theta, w, v, torques[i], h[i])  # fmt: skip
        x[i], x[THETA_DOT + i], x[PSI_DOT + i] = theta, w, v
        x[PSI + i] += change
        for m in range(0, 3 * STATE, STATE):
            n = m + i
            by_theta, by_w, by_v = columns[n], columns[THETA_DOT + n], columns[PSI_DOT + n]
            columns[n] = a1 * by_theta + a2 * by_w + a3 * by_v
            columns[PSI + n] += b1 * by_theta + b2 * by_w + b3 * by_v
            columns[THETA_DOT + n] = c1 * by_theta + c2 * by_w + c3 * by_v
            columns[PSI_DOT + n] = d1 * by_theta + d2 * by_w + d3 * by_v


@compiled
def _remember_peaks(x: Array, columns: Array, left: Array, peaks: Array) -> None:
    """Where |psi| is larger than any before: psi, time left, psi' and derivatives of psi."""
    for i in range(LANES):
        psi = x[PSI + i]
        larger = abs(psi) > abs(peaks[i])
        peaks[i] = psi if larger else peaks[i]
        peaks[LANES + i] = left[i] if larger else peaks[LANES + i]
        peaks[2 * LANES + i] = x[PSI_DOT + i] if larger else peaks[2 * LANES + i]
        for m in range(3):
            n = (3 + m) * LANES + i
            peaks[n] = columns[m * STATE + PSI + i] if larger else peaks[n]


@compiled
def _carry(x: Array, columns: Array, found: Array, at_peak: Array) -> None:
    """Carry a derivative of the states over an arc, and of psi to its peak."""
    for i in range(LANES):
        theta, psi, w, v = x[i], x[PSI + i], x[THETA_DOT + i], x[PSI_DOT + i]
        slope = found[3 * LANES + i] * theta + found[4 * LANES + i] * w + found[5 * LANES + i] * v
        at_peak[i] = psi + slope
        for m in range(0, STATE, LANES):
            n = m + i
            x[n] = columns[n] * theta + columns[STATE + n] * w + columns[2 * STATE + n] * v
        x[PSI + i] += psi


@compiled
def roll_lanes(
    k: Coefficients,
    durations: Array,
    torques: Array,
    arcs: int,
    counts: Integers,
    mesh: Array,
    share: float,
    state: Array,
    derivatives: Array,
    peaks: Array,
    peak_slopes: Array,
) -> None:
    """
    Integrate `LANES` motions from `state` (4 LANES,) over `arcs` arcs by RK4.

    An arc has `counts` (K,) steps, which are the shares `mesh` (n,) of its duration; more where
    they are longer than that `share` of `quick_time`, one if its duration is negative.
    `durations` [s] and `torques` [N m] (K, LANES) are given, K >= arcs. `state` becomes the final
    one. Filled are its `derivatives` (K, 4 LANES) by the durations; the psi of every arc that is
    largest in size, `peaks` (K, LANES); and its derivatives by the durations up to the arc's own,
    `peak_slopes` (K, K, LANES).

    The sensitivity of the states to an arc's duration is their rate x' at its end (exact for the
    motion itself, off by the error of RK4 for the discrete one). Every later arc propagates it by
    its transition matrix, the three `columns` by theta, theta', psi': nothing depends on psi.
    """
    h, columns, found = np.empty(LANES), np.empty(3 * STATE), np.empty(6 * LANES)
    left, quick, first = np.empty(LANES), np.empty(LANES), 0
    for arc in range(arcs):
        duration, torque = durations[arc], torques[arc]
        columns[:], found[:], left[:] = 0.0, 0.0, duration
        for i in range(LANES):
            columns[i] = columns[STATE + THETA_DOT + i] = columns[2 * STATE + PSI_DOT + i] = 1.0
        for node in range(MOST_STEPS):
            part = mesh[first + min(node, counts[arc] - 1)]
            quick[:] = np.inf
            if share < np.inf:
                for i in range(LANES):
                    w, v = state[THETA_DOT + i], state[PSI_DOT + i]
                    quick[i] = share * quick_time(k, state[i], w, v)
            longest = 0.0
            for i in range(LANES):
                step = min(quick[i], part * duration[i])
                some = 0.0 < step < ALL * left[i] and node < MOST_STEPS - 1
                h[i] = step if some else left[i]
                left[i] -= h[i]
                longest = max(left[i], longest)
            _step_lanes(k, state, h, torque, columns)
            _remember_peaks(state, columns, left, found)
            if not longest > 0.0:
                break
        first += counts[arc]
        for p in range(arc):
            _carry(derivatives[p], columns, found, peak_slopes[arc, p])
        peak, slope, rates = peaks[arc], peak_slopes[arc, arc], derivatives[arc]
        for i in range(LANES):
            # Within the arc, from its beginning: tau / d of the whole change by its duration.
            part = 1.0 - found[LANES + i] / duration[i] if duration[i] > 0.0 else 1.0
            peak[i], slope[i] = found[i], part * found[2 * LANES + i]
            w, v = state[THETA_DOT + i], state[PSI_DOT + i]
            rates[i], rates[PSI + i] = w, v
            rates[THETA_DOT + i], rates[PSI_DOT + i] = quick_accelerations(
                k, state[i], w, v, torque[i]
            )


@compiled
def step_lanes(k: Coefficients, x: Array) -> None:
    """One RK4 step of every lane; `x` begins with the states, the torques and the steps [s]."""
    for i in range(LANES):
        x[i], change, x[THETA_DOT + i], x[PSI_DOT + i] = runge_kutta(
            k, x[i], x[THETA_DOT + i], x[PSI_DOT + i], x[HELD + i], x[STEP + i]
        )
        x[PSI + i] += change


@compiled
def roll_ends(
    k: Coefficients,
    start: Array,
    durations: Array,
    torques: Array,
    arcs: Integers,
    share: float,
    limit: float,
) -> tuple[Array, Array]:
    """
    Integrate many motions from `start` (4,) by RK4, in steps of that `share` of `quick_time`.

    The first `arcs` (B,) of `durations` [s] and `torques` [N m] (B, K) count. Returns the final
    states (B, 4) and the largest |psi| on the way (B,). A motion ends where that is beyond `limit`
    [rad]: it may be however fast. One of too many steps ends, too, its largest |psi| infinite.
    """
    x, lanes = np.zeros(6 * LANES), np.full(LANES, -1, np.intp)
    arc, left, steps = np.zeros(LANES, np.intp), np.zeros(LANES), np.zeros(LANES, np.intp)
    ends, peaks = np.empty((arcs.size, 4)), np.zeros(arcs.size)
    taken, busy = 0, 0
    while taken < arcs.size or busy > 0:
        for i in range(LANES):
            x[STEP + i] = share * quick_time(k, x[i], x[THETA_DOT + i], x[PSI_DOT + i])
        for i in range(LANES):
            b = lanes[i]
            if b < 0 and taken < arcs.size:
                lanes[i], arc[i], left[i], steps[i], b = taken, 0, 0.0, 0, taken
                x[i:STATE:LANES] = start
                taken, busy = taken + 1, busy + 1
            if b < 0:
                continue
            peaks[b] = max(peaks[b], abs(x[PSI + i])) if steps[i] < _STEPS_OF_MOTION else np.inf
            steps[i] += 1
            while not left[i] > 0.0 and arc[i] < arcs[b]:
                x[HELD + i], left[i] = torques[b, arc[i]], durations[b, arc[i]]
                arc[i] += 1
            x[STEP + i] = min(x[STEP + i], left[i])
            left[i] -= x[STEP + i]
            if not x[STEP + i] > 0.0 or not peaks[b] <= limit:
                ends[b] = x[i:STATE:LANES]
                lanes[i], busy = -1, busy - 1
        step_lanes(k, x)
    return ends, peaks


class FeedbackTable(NamedTuple):
    """
    A tabulated law: in every interval T_k - K_k (x - r_k), saturated, is held, as trackers do.

    References r (n, 4), torques T (n,) [N m] and gains K (n, 4), one an interval of `step` s; the
    torque is saturated at `limit` [N m].
    """

    references: Array
    torques: Array
    gains: Array
    step: float
    limit: float


def roll_feedback(plant: RotaryPendulum, start: Array, table: FeedbackTable) -> Array:
    """States (n + 1, 4) at the ends of the table's intervals, from `start` (4,)."""
    references, torques, gains = (np.array(each, float) for each in table[:3])
    table = FeedbackTable(references, torques, gains, table.step, table.limit)
    states: Array = _roll_feedback(plant.coefficients, np.array(start, float), table)
    return states


@compiled
def _roll_feedback(k: Coefficients, start: Array, table: FeedbackTable) -> Array:
    references, torques, gains, step, limit = table
    states = np.empty((torques.size + 1, 4))
    states[0] = x = start.copy()
    for interval in range(torques.size):
        away = (x[0] - references[interval, 0] + math.pi) % (2.0 * math.pi) - math.pi
        torque = torques[interval] - gains[interval, 0] * away
        for m in range(1, 4):
            torque -= gains[interval, m] * (x[m] - references[interval, m])
        torque = min(max(torque, -limit), limit)
        for _ in range(_SUBSTEPS):
            x[0], change, x[2], x[3] = runge_kutta(k, x[0], x[2], x[3], torque, step / _SUBSTEPS)
            x[1] += change
        states[interval + 1] = x
    return states
