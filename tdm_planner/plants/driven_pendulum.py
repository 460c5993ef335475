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
The pendulum's angle where the disk's motion is given: the part that cannot be inverted.

With psi(t) known, the first equation of motion is one of second order for theta alone,

    A theta'' = (c/2) sin(2 theta) psi'^2 + m g l sin(theta) - m l r cos(theta) psi'',

and the torque follows from the second one (`RotaryPendulum.torque_for`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled, inlined
from tdm_planner.plants.pendulum_kernels import driven
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum
from tdm_planner.plants.slopes import with_slopes

Array = NDArray[np.float64]


def _angle(k: Coefficients, theta: Any, psi_dot: Any, psi_ddot: Any) -> tuple[Any, ...]:
    """Return theta'', which does not depend on theta'."""
    return driven(k, theta, 0.0, psi_dot, psi_ddot)[:1]


_angle_with_slopes = inlined(with_slopes(_angle, ('theta', 'psi_dot', 'psi_ddot'), k=Coefficients))


def drive_pendulum(
    plant: RotaryPendulum,
    start: Array,
    disk: Array,
    disk_slopes: Array,
    step: float,
    step_slopes: Array,
) -> tuple[Array, Array]:
    """
    Integrate theta by M RK4 steps of length `step` [s] from `start` (theta, theta').

    `disk` (2 M + 1, 2) holds psi', psi'' at the steps' ends and middles, `disk_slopes`
    (2 M + 1, 2, P) and `step_slopes` (P,) their derivatives by P parameters. Returns theta, theta'
    at the steps' ends, (M + 1, 2), and the exact derivatives of the discrete motion (M + 1, 2, P).
    """
    count, parameters = (len(disk) - 1) // 2, step_slopes.size
    states, slopes = np.empty((count + 1, 2)), np.empty((count + 1, 2, parameters))
    with np.errstate(all='ignore'):
        _drive(
            plant.coefficients,
            start,
            disk,
            disk_slopes,
            step,
            step_slopes,
            states,
            slopes,
        )
    return states, slopes


def compile_kernel(plant: RotaryPendulum) -> None:
    """Compile the kernel or load it from the disk."""
    drive_pendulum(plant, np.zeros(2), np.zeros((3, 2)), np.zeros((3, 2, 1)), 1e-3, np.zeros(1))


@compiled
def _drive(
    k: Coefficients,
    start: Array,
    disk: Array,
    disk_slopes: Array,
    step: float,
    step_slopes: Array,
    states: Array,
    slopes: Array,
) -> None:
    parameters = step_slopes.size
    speed, acceleration = np.empty(4), np.empty(4)
    speed_slope, acceleration_slope = np.empty((4, parameters)), np.empty((4, parameters))
    states[0, 0], states[0, 1] = start[0], start[1]
    slopes[0] = 0.0
    for node in range(states.shape[0] - 1):
        theta, theta_dot = states[node, 0], states[node, 1]
        for s in range(4):
            reach = 0.0 if s == 0 else (1.0 if s == 3 else 0.5)
            at = 2 * node + (0 if s == 0 else (2 if s == 3 else 1))
            angle, w = theta, theta_dot
            if s > 0:
                angle += reach * step * speed[s - 1]
                w += reach * step * acceleration[s - 1]
            if not abs(angle) < 1e9:
                angle = math.nan
            speed[s] = w
            acceleration[s], by_angle, by_speed, by_acceleration = _angle_with_slopes(
                k, angle, disk[at, 0], disk[at, 1]
            )
            for p in range(parameters):
                d_angle, d_w = slopes[node, 0, p], slopes[node, 1, p]
                if s > 0:
                    d_angle += reach * (
                        step * speed_slope[s - 1, p] + step_slopes[p] * speed[s - 1]
                    )
                    d_w += reach * (
                        step * acceleration_slope[s - 1, p] + step_slopes[p] * acceleration[s - 1]
                    )
                speed_slope[s, p] = d_w
                acceleration_slope[s, p] = (
                    by_angle * d_angle
                    + by_speed * disk_slopes[at, 0, p]
                    + by_acceleration * disk_slopes[at, 1, p]
                )
        mean_speed = (speed[0] + 2.0 * speed[1] + 2.0 * speed[2] + speed[3]) / 6.0
        mean_acceleration = (
            acceleration[0] + 2.0 * acceleration[1] + 2.0 * acceleration[2] + acceleration[3]
        ) / 6.0
        states[node + 1, 0] = theta + step * mean_speed
        states[node + 1, 1] = theta_dot + step * mean_acceleration
        for p in range(parameters):
            slopes[node + 1, 0, p] = (
                slopes[node, 0, p]
                + step_slopes[p] * mean_speed
                + step
                / 6.0
                * (
                    speed_slope[0, p]
                    + 2.0 * speed_slope[1, p]
                    + 2.0 * speed_slope[2, p]
                    + speed_slope[3, p]
                )
            )
            slopes[node + 1, 1, p] = (
                slopes[node, 1, p]
                + step_slopes[p] * mean_acceleration
                + step
                / 6.0
                * (
                    acceleration_slope[0, p]
                    + 2.0 * acceleration_slope[1, p]
                    + 2.0 * acceleration_slope[2, p]
                    + acceleration_slope[3, p]
                )
            )
