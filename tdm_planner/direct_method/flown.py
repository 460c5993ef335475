# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A motion as it was integrated: polynomials between the steps, all of them read at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Flown:
    """
    A motion as it was integrated: polynomials between the instants `ts` (m + 1,).

    `begins` (m, nx) are the states there, `coefficients` (m, 7, nx) those of the dense output.
    """

    ts: Array
    begins: Array
    coefficients: Array

    @property
    def t_min(self) -> float:
        """First instant [s]."""
        return float(self.ts[0])

    @property
    def t_max(self) -> float:
        """Last instant [s]."""
        return float(self.ts[-1])

    def __call__(self, times: Array) -> Array:
        """States at `times` (n,), (nx, n)."""
        step = np.clip(np.searchsorted(self.ts, times, side='right') - 1, 0, len(self.begins) - 1)
        share = ((times - self.ts[step]) / np.diff(self.ts)[step])[:, None]
        rows = self.coefficients[step]
        value = np.zeros_like(rows[:, 0])
        for index in range(rows.shape[1]):
            value = (value + rows[:, -1 - index]) * ((1.0 - share) if index % 2 else share)
        return np.asarray((value + self.begins[step]).T)
