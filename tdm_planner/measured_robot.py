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

"""What was measured of a robot, and of the distance between two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MeasuredRobot:
    """What a robot published: times (n,) s from the start of the motion, columns by name (n,)."""

    times: Array
    columns: Mapping[str, Array]


def pair_distance(one: MeasuredRobot, other: MeasuredRobot) -> tuple[Array, Array]:
    """Return the instants of `one` [s] that `other` covers too, and the distances then [m]."""
    inside = (one.times >= other.times[0]) & (one.times <= other.times[-1])
    times = one.times[inside]
    apart = [
        one.columns[axis][inside] - np.interp(times, other.times, other.columns[axis])
        for axis in ('x', 'y')
    ]
    return times, np.hypot(*apart)
