# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Compiled search for the torque that turns the disk of a rotary pendulum the least."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.plants.pendulum_kernels import quick_accelerations
from tdm_planner.plants.rotary_pendulum import Coefficients, RotaryPendulum

Array = NDArray[np.float64]

_SWITCHES = 24  # intervals of the grid of either switch


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


def compile_least_peak(plant: RotaryPendulum) -> None:
    """Compile the kernel or load it from the disk."""
    least_peak(plant.coefficients, np.zeros(4), 1.0, 0.0, 1.0, 1.0)
