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
Motion of the rotary pendulum under a tabulated feedback law, compiled.

In every interval the torque T_k - K_k (x - r_k), saturated, is held: what a tracker does with a
plan, step by step, fast enough to look ahead to the plan's end before each new plan.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.compilation import compiled
from tdm_planner.plants.rotary_pendulum import RotaryPendulum

Array = NDArray[np.float64]

_SUBSTEPS = 2  # RK4 steps an interval


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
            np.array(plant.coefficients),
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
    k: Array,
    start: Array,
    references: Array,
    torques: Array,
    gains: Array,
    limit: float,
    h: float,
    states: Array,
) -> None:
    x, rates, y = start.copy(), np.empty((4, 4)), np.empty(4)
    states[0] = x
    for interval in range(torques.size):
        away = (x[0] - references[interval, 0] + math.pi) % (2.0 * math.pi) - math.pi
        torque = torques[interval] - gains[interval, 0] * away
        for m in range(1, 4):
            torque -= gains[interval, m] * (x[m] - references[interval, m])
        torque = min(max(torque, -limit), limit)
        for _ in range(_SUBSTEPS):
            for s in range(4):
                reach = 0.0 if s == 0 else (0.5 * h if s < 3 else h)
                for m in range(4):
                    y[m] = x[m] + (reach * rates[s - 1, m] if s > 0 else 0.0)
                sine, cosine = math.sin(y[0]), math.cos(y[0])
                double_sine = 2.0 * sine * cosine
                b = k[5] * cosine
                j = k[2] + k[3] * sine * sine + k[4] * cosine * cosine
                inverse = 1.0 / (k[1] * j - b * b)
                r1 = 0.5 * k[0] * double_sine * y[3] * y[3] + k[6] * sine
                r2 = torque - k[0] * double_sine * y[2] * y[3] + k[5] * sine * y[2] * y[2]
                rates[s, 0], rates[s, 1] = y[2], y[3]
                rates[s, 2] = (j * r1 - b * r2) * inverse
                rates[s, 3] = (k[1] * r2 - b * r1) * inverse
            for m in range(4):
                x[m] += (
                    h / 6.0 * (rates[0, m] + 2.0 * rates[1, m] + 2.0 * rates[2, m] + rates[3, m])
                )
        states[interval + 1] = x
