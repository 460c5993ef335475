# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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

Array = NDArray[np.float64]

LANES = 16  # with 8 the compiler unrolls the loops instead
STATE = 4 * LANES
_PSI, _THETA_DOT, _PSI_DOT = LANES, 2 * LANES, 3 * LANES
_SLOPES = 6 * LANES  # of the accelerations by theta, theta', psi'


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


@compiled
def _stage(
    k: Array,
    state: Array,
    before: Array,
    share: float,
    h: Array,
    torques: Array,
    rates: Array,
    slopes: Array,
) -> None:
    """Rates at `state + share h before`, and the slopes of the accelerations there."""
    k0, k1, k2, k3, k4, k5, k6 = k[0], k[1], k[2], k[3], k[4], k[5], k[6]
    for i in range(LANES):
        reach = share * h[i]
        theta = state[i] + reach * before[i]
        w = state[_THETA_DOT + i] + reach * before[_THETA_DOT + i]
        v = state[_PSI_DOT + i] + reach * before[_PSI_DOT + i]
        sine, cosine = sine_and_cosine(theta)
        double_sine, double_cosine = 2.0 * sine * cosine, cosine * cosine - sine * sine
        b, b_theta = k5 * cosine, -k5 * sine
        j, j_theta = k2 + k3 * sine * sine + k4 * cosine * cosine, (k3 - k4) * double_sine
        inverse = 1.0 / (k1 * j - b * b)
        r1 = 0.5 * k0 * double_sine * v * v + k6 * sine
        r2 = torques[i] - k0 * double_sine * w * v + k5 * sine * w * w
        theta_ddot, psi_ddot = (j * r1 - b * r2) * inverse, (k1 * r2 - b * r1) * inverse
        rates[i], rates[_PSI + i] = w, v
        rates[_THETA_DOT + i], rates[_PSI_DOT + i] = theta_ddot, psi_ddot
        d1 = k0 * double_cosine * v * v + k6 * cosine - b_theta * psi_ddot
        d2 = (k5 * cosine * w - 2.0 * k0 * double_cosine * v) * w
        d2 -= b_theta * theta_ddot + j_theta * psi_ddot
        slopes[i], slopes[LANES + i] = (j * d1 - b * d2) * inverse, (k1 * d2 - b * d1) * inverse
        d2 = 2.0 * k5 * sine * w - k0 * double_sine * v
        slopes[2 * LANES + i], slopes[3 * LANES + i] = -b * d2 * inverse, k1 * d2 * inverse
        d1, d2 = k0 * double_sine * v, -k0 * double_sine * w
        slopes[4 * LANES + i] = (j * d1 - b * d2) * inverse
        slopes[5 * LANES + i] = (k1 * d2 - b * d1) * inverse


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
def _remember_peaks(state: Array, node: float, peaks: Array, nodes: Array) -> None:
    """Where |psi| is larger than any before in the arc: psi and its node."""
    for i in range(LANES):
        psi = state[_PSI + i]
        larger = abs(psi) > abs(peaks[i])
        nodes[i] = node if larger else nodes[i]
        peaks[i] = psi if larger else peaks[i]


@compiled
def roll_lanes(
    k: Array,
    start: Array,
    durations: Array,
    torques: Array,
    arcs: int,
    steps: int,
    state: Array,
    derivatives: Array,
    disk_slopes: Array,
    peaks: Array,
    nodes: Array,
) -> None:
    """
    Integrate `LANES` motions from `start` (4,) over `arcs` arcs of `steps` RK4 steps.

    `durations` [s] and `torques` [N m] (K, LANES) are given, K >= arcs. Filled are the final
    `state` (4 LANES,) and its `derivatives` (K, 4 LANES) by the durations; the psi of every
    arc that is largest in size, `peaks` (K, LANES), the nodes where they are, `nodes` (K, LANES),
    and the derivatives of psi by the durations at every node, `disk_slopes` (K steps + 1, K,
    LANES).

    The derivative by an arc's duration begins at its end with the rate of the states there. That
    is exact for the motion itself; of the discrete motion it is off by the error of RK4.
    """
    stages, slopes, h = np.empty((4, STATE)), np.empty((4, _SLOPES)), np.empty(LANES)
    nothing, flat = np.zeros(STATE), slopes.ravel()
    for m in range(4):
        for i in range(LANES):
            state[m * LANES + i] = start[m]
    first, second, third, fourth = stages[0], stages[1], stages[2], stages[3]
    node = 0
    for arc in range(arcs):
        torque = torques[arc]
        for i in range(LANES):
            h[i] = durations[arc, i] / steps
            peaks[arc, i], nodes[arc, i] = 0.0, node + 1
        for _ in range(steps):
            node += 1
            _stage(k, state, nothing, 0.0, h, torque, first, slopes[0])
            _stage(k, state, first, 0.5, h, torque, second, slopes[1])
            _stage(k, state, second, 0.5, h, torque, third, slopes[2])
            _stage(k, state, third, 1.0, h, torque, fourth, slopes[3])
            _advance(state, h, stages.ravel())
            _remember_peaks(state, node, peaks[arc], nodes[arc])
            for p in range(arc):
                derivative, slope = derivatives[p], disk_slopes[node, p]
                _advance_derivative(derivative, h, flat)
                for i in range(LANES):
                    slope[i] = derivative[_PSI + i]
            # Within the arc, from its beginning: tau / d of the whole change by its duration.
            slope, share = disk_slopes[node, arc], (node - arc * steps) / steps
            for i in range(LANES):
                slope[i] = share * state[_PSI_DOT + i]
        _stage(k, state, nothing, 0.0, h, torque, first, slopes[0])
        derivatives[arc, :] = first
