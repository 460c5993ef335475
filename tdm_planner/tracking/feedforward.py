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
The planned control as a command that is held over an interval: its mean over the interval.

Switches do not fall on the ticks of a tracker; the mean gives the plant the same impulse as the
plan, whereas the value at the tick would shift every switch by up to an interval.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tdm_planner.trajectory import Trajectory

Array = NDArray[np.float64]


class Feedforward:
    """Mean of a trajectory's controls over any interval; they are zero outside the trajectory."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._integral = trajectory.control_integral

    def mean(self, start: float, end: float) -> Array:
        """Mean control (nu,) over [start, end], times [s] as in the trajectory, start < end."""
        integral = self._integral([start, end])
        mean: Array = (integral[1] - integral[0]) / (end - start)
        return mean

    def means(self, edges: Array) -> Array:
        """Mean controls (n, nu) between neighbouring `edges` (n + 1,), times that increase."""
        means: Array = np.diff(self._integral(edges), axis=0) / np.diff(edges)[:, None]
        return means
