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

"""What became of a stream of stamped messages between where it was sent and where it arrived."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SAME = 1e-6  # s between stamps that are one


@dataclass(frozen=True)
class Stream:
    """
    Figures of a stream; times in ms.

    `lost` of `sent` never came. `age` is from stamp to arrival; `gap` is the time between two
    arrivals, `period_error` how far the time between two stamps is from the nominal one.
    """

    sent: int
    lost: int
    overtaken: int
    period_error_p50: float
    period_error_p99: float
    period_error_worst: float
    age_p50: float
    age_p99: float
    age_worst: float
    gap_p99: float
    gap_worst: float

    def to_dict(self) -> dict[str, Any]:
        """Return the figures by name."""
        return asdict(self)

    def __str__(self) -> str:
        return (
            f'{self.sent} sent, {self.lost} lost ({self.lost / max(self.sent, 1):.1%}), '
            f'{self.overtaken} overtaken; sent with an error of the period of p50 '
            f'{self.period_error_p50:.1f}, p99 {self.period_error_p99:.1f}, worst '
            f'{self.period_error_worst:.0f} ms; age on arrival p50 {self.age_p50:.1f}, p99 '
            f'{self.age_p99:.1f}, worst {self.age_worst:.0f} ms; longest without one '
            f'{self.gap_worst:.0f} ms'
        )


def compare(sent: Array, arrived: Array, period: float, window: tuple[float, float]) -> Stream:
    """
    Compare stamps and arrivals (n, 2) [s] at both ends, of stamps within a window [s].

    Raises
    ------
    ValueError
        If there are fewer than three messages at either end.

    """
    sent, arrived = (rows[(rows[:, 0] >= window[0]) & (rows[:, 0] <= window[1])]
                     for rows in (sent, arrived))  # fmt: skip
    if len(sent) < 3 or len(arrived) < 3:
        raise ValueError(f'{len(sent)} messages sent, {len(arrived)} arrived: too few to compare')
    stamps = np.sort(sent[:, 0])
    error = 1e3 * np.abs(np.diff(stamps) - period)
    age = 1e3 * (arrived[:, 1] - arrived[:, 0])
    gap = 1e3 * np.diff(arrived[:, 1])
    came = np.abs(stamps - _nearest(np.sort(arrived[:, 0]), stamps))
    return Stream(
        sent=len(stamps),
        lost=int((came > _SAME).sum()),
        overtaken=int((np.diff(arrived[:, 0]) < 0).sum()),
        period_error_p50=float(np.median(error)),
        period_error_p99=float(np.quantile(error, 0.99)),
        period_error_worst=float(error.max()),
        age_p50=float(np.median(age)),
        age_p99=float(np.quantile(age, 0.99)),
        age_worst=float(age.max()),
        gap_p99=float(np.quantile(gap, 0.99)),
        gap_worst=float(gap.max()),
    )


def _nearest(among: Array, to: Array) -> Array:
    """Return the value of the sorted `among` (m,) nearest to each of `to` (n,)."""
    index = np.clip(np.searchsorted(among, to), 1, len(among) - 1)
    below, above = among[index - 1], among[index]
    return np.asarray(np.where(to - below < above - to, below, above))
