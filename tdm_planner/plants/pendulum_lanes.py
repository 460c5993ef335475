# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Many motions of the rotary pendulum side by side, for the vector units of the processor.

`LANES` motions under arcs of constant torque are integrated in lock step by RK4, with their
derivatives. Quantities of all lanes stand in one flat array, `row * LANES + lane`, and `LANES` is
a constant: so the compiler sees that rows do not overlap and turns every loop over lanes into
vector instructions, several times as fast as one motion after the other. What a lane computes
does not depend on the others. Rows of a state are (theta, psi, theta', psi').
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.plants.pendulum_kernels import (
    accelerations_with_slopes,
    quick_time,
    runge_kutta,
)
from tdm_planner.plants.rotary_pendulum import Coefficients

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

LANES = 16  # with 8 the compiler unrolls the loops instead
STATE = 4 * LANES
_PSI, _THETA_DOT, _PSI_DOT = LANES, 2 * LANES, 3 * LANES
HELD, STEP = 4 * LANES, 5 * LANES  # behind the state: torque, duration of a step
_SLOPES = 6 * LANES  # of the accelerations by theta, theta', psi'


@compiled
def _stage(
    k: Coefficients,
    state: Array,
    before: Array,
    share: float,
    h: Array,
    torques: Array,
    rates: Array,
    slopes: Array,
) -> None:
    """Rates at `state + share h before`, and the slopes of the accelerations there."""
    for i in range(LANES):
        reach = share * h[i]
        theta = state[i] + reach * before[i]
        w = state[_THETA_DOT + i] + reach * before[_THETA_DOT + i]
        v = state[_PSI_DOT + i] + reach * before[_PSI_DOT + i]
        rates[i], rates[_PSI + i] = w, v
        (
            rates[_THETA_DOT + i], rates[_PSI_DOT + i],
            slopes[i], slopes[LANES + i],
            slopes[2 * LANES + i], slopes[3 * LANES + i],
            slopes[4 * LANES + i], slopes[5 * LANES + i],
        ) = accelerations_with_slopes(k, theta, w, v, torques[i])  # fmt: skip


@compiled
def _advance(state: Array, h: Array, rates: Array) -> None:
    """Advance the states by one step, from the rates at its four stages."""
    for i in range(LANES):
        sixth = h[i] / 6.0
        for m in range(0, STATE, LANES):
            n = m + i
            middle = rates[STATE + n] + rates[2 * STATE + n]
            state[n] += sixth * (rates[n] + 2.0 * middle + rates[3 * STATE + n])


@compiled
def _advance_derivative(x: Array, h: Array, g: Array) -> None:
    """Carry derivatives of the states over one step: the same RK4, linearised at its stages."""
    for i in range(LANES):
        step = h[i]
        half, sixth = 0.5 * step, step / 6.0
        t1, w1, v1 = x[i], x[_THETA_DOT + i], x[_PSI_DOT + i]
        n = i
        a1 = g[n] * t1 + g[n + 2 * LANES] * w1 + g[n + 4 * LANES] * v1
        b1 = g[n + LANES] * t1 + g[n + 3 * LANES] * w1 + g[n + 5 * LANES] * v1
        t2, w2, v2 = t1 + half * w1, w1 + half * a1, v1 + half * b1
        n = i + _SLOPES
        a2 = g[n] * t2 + g[n + 2 * LANES] * w2 + g[n + 4 * LANES] * v2
        b2 = g[n + LANES] * t2 + g[n + 3 * LANES] * w2 + g[n + 5 * LANES] * v2
        t3, w3, v3 = t1 + half * w2, w1 + half * a2, v1 + half * b2
        n = i + 2 * _SLOPES
        a3 = g[n] * t3 + g[n + 2 * LANES] * w3 + g[n + 4 * LANES] * v3
        b3 = g[n + LANES] * t3 + g[n + 3 * LANES] * w3 + g[n + 5 * LANES] * v3
        t4, w4, v4 = t1 + step * w3, w1 + step * a3, v1 + step * b3
        n = i + 3 * _SLOPES
        a4 = g[n] * t4 + g[n + 2 * LANES] * w4 + g[n + 4 * LANES] * v4
        b4 = g[n + LANES] * t4 + g[n + 3 * LANES] * w4 + g[n + 5 * LANES] * v4
        x[i] = t1 + sixth * (w1 + 2.0 * (w2 + w3) + w4)
        x[_PSI + i] += sixth * (v1 + 2.0 * (v2 + v3) + v4)
        x[_THETA_DOT + i] = w1 + sixth * (a1 + 2.0 * (a2 + a3) + a4)
        x[_PSI_DOT + i] = v1 + sixth * (b1 + 2.0 * (b2 + b3) + b4)


@compiled
def _remember_peaks(
    state: Array, columns: Array, node: float, peaks: Array, nodes: Array, row: Array
) -> None:
    """Where |psi| is larger than any before in the arc: psi, its derivatives and its node."""
    for i in range(LANES):
        psi = state[_PSI + i]
        larger = abs(psi) > abs(peaks[i])
        peaks[i] = psi if larger else peaks[i]
        nodes[i] = node if larger else nodes[i]
        row[i] = columns[_PSI + i] if larger else row[i]
        row[LANES + i] = columns[STATE + _PSI + i] if larger else row[LANES + i]
        row[2 * LANES + i] = columns[2 * STATE + _PSI + i] if larger else row[2 * LANES + i]
        row[3 * LANES + i] = state[_PSI_DOT + i] if larger else row[3 * LANES + i]


@compiled
def _carry(x: Array, columns: Array, row: Array, at_peak: Array) -> None:
    """Carry a derivative of the states over an arc, and of psi to its peak."""
    for i in range(LANES):
        theta, w, v = x[i], x[_THETA_DOT + i], x[_PSI_DOT + i]
        at_peak[i] = x[_PSI + i] + row[i] * theta + row[LANES + i] * w + row[2 * LANES + i] * v
        psi = x[_PSI + i]
        for m in range(0, STATE, LANES):
            n = m + i
            x[n] = columns[n] * theta + columns[STATE + n] * w + columns[2 * STATE + n] * v
        x[_PSI + i] += psi


@compiled
def roll_lanes(
    k: Coefficients,
    durations: Array,
    torques: Array,
    arcs: int,
    steps: int,
    state: Array,
    derivatives: Array,
    peaks: Array,
    peak_slopes: Array,
) -> None:
    """
    Integrate `LANES` motions from `state` (4 LANES,) over `arcs` arcs of `steps` RK4 steps.

    `durations` [s] and `torques` [N m] (K, LANES) are given, K >= arcs. `state` becomes the final
    one. Filled are its `derivatives` (K, 4 LANES) by the durations; the psi of every arc that is
    largest in size, `peaks` (K, LANES); and its derivatives by the durations up to the arc's own,
    `peak_slopes` (K, K, LANES).

    The derivative by an arc's duration begins at its end with the rate of the states there. That
    is exact for the motion itself; of the discrete motion it is off by the error of RK4. Later
    arcs carry all of them at once, by the derivatives of the states by those in which they begin:
    three columns (by theta, theta', psi'; the motion does not depend on psi).
    """
    stages, slopes, h = np.empty((4, STATE)), np.empty((4, _SLOPES)), np.empty(LANES)
    nothing, flat, nodes = np.zeros(STATE), slopes.ravel(), np.empty(LANES)
    first, second, third, fourth = stages[0], stages[1], stages[2], stages[3]
    columns, row = np.zeros(3 * STATE), np.zeros(4 * LANES)
    parts = columns.reshape(3, STATE)
    by_theta, by_w, by_v = parts[0], parts[1], parts[2]
    for arc in range(arcs):
        torque, peak = torques[arc], peaks[arc]
        columns[:] = 0.0
        for i in range(LANES):
            h[i] = durations[arc, i] / steps
            peak[i], nodes[i] = 0.0, 0.0
            columns[i] = columns[STATE + _THETA_DOT + i] = 1.0
            columns[2 * STATE + _PSI_DOT + i] = 1.0
        for node in range(1, steps + 1):
            _stage(k, state, nothing, 0.0, h, torque, first, slopes[0])
            _stage(k, state, first, 0.5, h, torque, second, slopes[1])
            _stage(k, state, second, 0.5, h, torque, third, slopes[2])
            _stage(k, state, third, 1.0, h, torque, fourth, slopes[3])
            _advance(state, h, stages.ravel())
            if arc > 0:
                _advance_derivative(by_theta, h, flat)
                _advance_derivative(by_w, h, flat)
                _advance_derivative(by_v, h, flat)
            _remember_peaks(state, columns, node, peak, nodes, row)
        for p in range(arc):
            _carry(derivatives[p], columns, row, peak_slopes[arc, p])
        # Within the arc, from its beginning: tau / d of the whole change by its duration.
        slope = peak_slopes[arc, arc]
        for i in range(LANES):
            slope[i] = nodes[i] / steps * row[3 * LANES + i]
        _stage(k, state, nothing, 0.0, h, torque, first, slopes[0])
        derivatives[arc, :] = first


@compiled
def step_lanes(k: Coefficients, x: Array) -> None:
    """One RK4 step of every lane; `x` begins with the states, the torques and the steps [s]."""
    for i in range(LANES):
        x[i], x[_PSI + i], x[_THETA_DOT + i], x[_PSI_DOT + i] = runge_kutta(
            k, x[i], x[_PSI + i], x[_THETA_DOT + i], x[_PSI_DOT + i], x[HELD + i], x[STEP + i]
        )


@compiled
def roll_ends(
    k: Coefficients,
    start: Array,
    durations: Array,
    torques: Array,
    arcs: Integers,
    share: float,
    limit: float,
    ends: Array,
    peaks: Array,
) -> None:
    """
    Integrate many motions from `start` (4,) by RK4, in steps of that `share` of `quick_time`.

    The first `arcs` (B,) of `durations` [s] and `torques` [N m] (B, K) count. Filled are the final
    states `ends` (B, 4) and the largest |psi| on the way, `peaks` (B,). A motion ends where that
    is beyond `limit` [rad]: it may be however fast.
    """
    x, lanes = np.zeros(6 * LANES), np.full(LANES, -1, np.intp)
    arc, left = np.zeros(LANES, np.intp), np.zeros(LANES)
    taken, busy = 0, 0
    while taken < arcs.size or busy > 0:
        for i in range(LANES):
            x[STEP + i] = share * quick_time(k, x[i], x[_THETA_DOT + i], x[_PSI_DOT + i])
        for i in range(LANES):
            b = lanes[i]
            if b < 0 and taken < arcs.size:
                lanes[i], arc[i], left[i], b = taken, 0, 0.0, taken
                for m in range(4):
                    x[m * LANES + i] = start[m]
                peaks[b] = 0.0
                taken, busy = taken + 1, busy + 1
            if b < 0:
                continue
            peaks[b] = max(peaks[b], abs(x[_PSI + i]))
            while not left[i] > 0.0 and arc[i] < arcs[b]:
                x[HELD + i], left[i] = torques[b, arc[i]], durations[b, arc[i]]
                arc[i] += 1
            x[STEP + i] = min(x[STEP + i], left[i])
            left[i] -= x[STEP + i]
            if x[STEP + i] == 0.0 or not peaks[b] <= limit:
                for m in range(4):
                    ends[b, m] = x[m * LANES + i]
                lanes[i], busy = -1, busy - 1
        step_lanes(k, x)
