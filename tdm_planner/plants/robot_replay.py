# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The floating robot's states by quadrature, one interval after the other, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled

Array = NDArray[np.float64]

# Gauss-Legendre nodes and weights on [0, 1], by their number n: exact to order 2 n - 1.
GAUSS = {
    count: ((nodes + 1.0) / 2.0, weights / 2.0)
    for count, (nodes, weights) in ((n, np.polynomial.legendre.leggauss(n)) for n in (2, 3, 4))
}
_TURNS = ((0.02, 2), (0.2, 3))  # rad by which a heading may turn in an interval, nodes that do


def nodes_for(steps: Array, rate: Array, omega: Array) -> int:
    """
    Return the number of nodes that leave an error of rounding at this scale.

    An interval in which the heading turns by d has an error of d^4 / 4320 of the velocity gained
    with two nodes, of d^6 / 2e6 with three: less than 1e-10 here.
    """
    fastest = np.abs(rate).max(initial=0.0) + np.abs(omega).max(initial=0.0)
    turn = float(steps.max(initial=0.0) * fastest)
    return next((count for most, count in _TURNS if turn < most), 4)


def compile_robot_replay() -> None:
    """Compile the kernel or load it from the disk."""
    states, controls = np.zeros((2, 7)), np.zeros((1, 3))
    integrate(np.ones(1), controls, controls, 1.0, 1.0, *GAUSS[2], states)


@compiled
def integrate(
    steps: Array,
    begin: Array,
    slope: Array,
    mass: float,
    inertia: float,
    nodes: Array,
    weights: Array,
    states: Array,
) -> None:
    """
    Fill `states` (n, 7) from the first of them on.

    Controls (n - 1, 3) are `begin` at the beginning of an interval of `steps` (n - 1,) s and
    change by `slope` (n - 1, 3) per second.
    """
    x, y, u, v, yaw, omega, alpha = states[0]
    for k in range(steps.size):
        h = steps[k]
        torque, torque_slope = begin[k, 2] / inertia, slope[k, 2] / inertia
        for j in range(nodes.size):
            t = h * nodes[j]
            heading = yaw + t * (omega + t * (torque / 2.0 + t * torque_slope / 6.0))
            heading += alpha + t * (begin[k, 1] + t * slope[k, 1] / 2.0)
            push = h * weights[j] * (begin[k, 0] + t * slope[k, 0]) / mass
            along, across = push * math.cos(heading), push * math.sin(heading)
            # The position gains what is left of the interval times the velocity gained.
            x += along * (h - t)
            y += across * (h - t)
            states[k + 1, 2] += along
            states[k + 1, 3] += across
        x += h * u
        y += h * v
        u += states[k + 1, 2]
        v += states[k + 1, 3]
        yaw += h * (omega + h * (torque / 2.0 + h * torque_slope / 6.0))
        omega += h * (torque + h * torque_slope / 2.0)
        alpha += h * (begin[k, 1] + h * slope[k, 1] / 2.0)
        row = states[k + 1]
        row[0], row[1], row[2], row[3], row[4], row[5], row[6] = x, y, u, v, yaw, omega, alpha
