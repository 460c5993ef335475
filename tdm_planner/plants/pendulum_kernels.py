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
Compiled motion of the rotary pendulum under arcs of constant torque.

Coefficients `k` are those of `rotary_pendulum.Coefficients`, in order. States are
(theta, psi, theta', psi').
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.plants.pendulum_lanes import sine_and_cosine

Array = NDArray[np.float64]


@compiled
def _accelerate(
    k: Array,
    theta: float,
    theta_dot: float,
    psi_dot: float,
    torque: float,
    slopes: Array,
    stage: int,
    with_slopes: bool,
) -> tuple[float, float]:
    """Accelerations theta'', psi''; their slopes by theta, theta', psi' go to slopes[stage]."""
    sine, cosine = sine_and_cosine(theta)
    double_sine = 2.0 * sine * cosine
    b = k[5] * cosine
    j = k[2] + k[3] * sine * sine + k[4] * cosine * cosine
    inverse = 1.0 / (k[1] * j - b * b)
    r1 = 0.5 * k[0] * double_sine * psi_dot * psi_dot + k[6] * sine
    r2 = torque - k[0] * double_sine * theta_dot * psi_dot + k[5] * sine * theta_dot * theta_dot
    theta_ddot = (j * r1 - b * r2) * inverse
    psi_ddot = (k[1] * r2 - b * r1) * inverse
    if with_slopes:
        double_cosine = cosine * cosine - sine * sine
        b_theta = -k[5] * sine
        j_theta = (k[3] - k[4]) * double_sine
        d1 = k[0] * double_cosine * psi_dot * psi_dot + k[6] * cosine - b_theta * psi_ddot
        d2 = (
            (k[5] * cosine * theta_dot - 2.0 * k[0] * double_cosine * psi_dot) * theta_dot
            - b_theta * theta_ddot
            - j_theta * psi_ddot
        )
        slopes[stage, 0] = (j * d1 - b * d2) * inverse
        slopes[stage, 1] = (k[1] * d2 - b * d1) * inverse
        d2 = -k[0] * double_sine * psi_dot + 2.0 * k[5] * sine * theta_dot
        slopes[stage, 2] = -b * d2 * inverse
        slopes[stage, 3] = k[1] * d2 * inverse
        d1 = k[0] * double_sine * psi_dot
        d2 = -k[0] * double_sine * theta_dot
        slopes[stage, 4] = (j * d1 - b * d2) * inverse
        slopes[stage, 5] = (k[1] * d2 - b * d1) * inverse
    return theta_ddot, psi_ddot


@compiled
def roll_arcs(
    k: Array,
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
                rates[s, 2], rates[s, 3] = _accelerate(
                    k, angle, w, v, torque, slopes, s, with_sensitivities
                )
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
