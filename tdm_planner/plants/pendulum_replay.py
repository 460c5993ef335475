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
The rotary pendulum replayed by a method of eighth order, compiled, to check plans quickly.

Plans are made with the classical method of fourth order; what checks them must not share its
errors. This is the twelve-stage formula of Dormand and Prince (Hairer, Norsett and Wanner,
"Solving Ordinary Differential Equations I"), with the coefficients of scipy's DOP853, at a fixed
step so short that its error is that of rounding.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled

if TYPE_CHECKING:
    from tdm_planner.plants.rotary_pendulum import RotaryPendulum
    from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]

_STAGES = 12
_LONGEST = 0.05  # of 1/w0: no step is longer
_FASTEST = 0.3  # rad, that no angle turns by in one step


def replay_pendulum(plant: RotaryPendulum, trajectory: Trajectory, times: Array) -> Array | None:
    """
    States (n, 4) at `times` (n,), which increase, from the first state of `trajectory`.

    None where that would be inaccurate: where a held control jumps between two `times`, or where
    they are too far apart.
    """
    if times.size < 2 or abs(times[0] - trajectory.times[0]) > 1e-12:
        return None
    steps = np.diff(times)
    fastest = float(np.abs(trajectory.states[:, 2:]).max())
    longest = min(_LONGEST / plant.natural_frequency, _FASTEST / max(fastest, 1e-9))
    if steps.max() > longest:
        return None
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
        replay_steps(np.array(plant.coefficients), steps, torques, *formula[1:], states)
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
        np.array(plant.coefficients),
        np.full(1, 1e-3),
        np.zeros((1, _STAGES)),
        *dormand_prince()[1:],
        np.zeros((2, 4)),
    )


@compiled
def replay_steps(
    k: Array, steps: Array, torques: Array, matrix: Array, weights: Array, states: Array
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
            sine, cosine = math.sin(y[0]), math.cos(y[0])
            double_sine = 2.0 * sine * cosine
            b = k[5] * cosine
            j = k[2] + k[3] * sine * sine + k[4] * cosine * cosine
            inverse = 1.0 / (k[1] * j - b * b)
            r1 = 0.5 * k[0] * double_sine * y[3] * y[3] + k[6] * sine
            r2 = torques[node, s] - k[0] * double_sine * y[2] * y[3] + k[5] * sine * y[2] * y[2]
            rates[s, 0], rates[s, 1] = y[2], y[3]
            rates[s, 2] = (j * r1 - b * r2) * inverse
            rates[s, 3] = (k[1] * r2 - b * r1) * inverse
        for m in range(4):
            total = 0.0
            for s in range(12):
                total += weights[s] * rates[s, m]
            states[node + 1, m] = states[node, m] + h * total
