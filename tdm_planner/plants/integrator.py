# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The classical Runge-Kutta method with held controls: for simulated plants and predictions."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plants.base import Plant

Array = NDArray[np.float64]

LARGEST_STEP = 1e-3  # s


def runge_kutta_step(plant: Plant, state: Array, control: Array, step: float) -> Array:
    """Advance states (..., nx) by `step` s under held controls (..., nu); error O(step^5)."""
    k1 = plant.derivative(state, control)
    k2 = plant.derivative(state + 0.5 * step * k1, control)
    k3 = plant.derivative(state + 0.5 * step * k2, control)
    k4 = plant.derivative(state + step * k3, control)
    return state + step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def integrate(
    plant: Plant,
    state: Array,
    control: Array,
    duration: float,
    largest_step: float = LARGEST_STEP,
    after_step: Callable[[Array], Array] | None = None,
) -> Array:
    """
    State(s) after `duration` s under held control(s), in equal steps of at most `largest_step`.

    `after_step`, where given, replaces the state after every step (contacts). A duration of zero
    returns the state unchanged; a negative one raises ValueError.
    """
    if duration < 0.0:
        raise ValueError(f'cannot integrate over a negative duration of {duration} s')
    # Rounding must not cost a step: 0.005 / 0.001 is 5.000000000000001 at times.
    steps = math.ceil(duration / largest_step * (1.0 - 1e-12))
    for _ in range(steps):
        state = runge_kutta_step(plant, state, control, duration / steps)
        if after_step is not None:
            state = after_step(state)
    return state
