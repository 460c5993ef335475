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

"""Simulated time in a recording: `/clock` as it was shown, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_sim.report.recorded_topics import CLOCK, RecordedTopics

_LEAST = 10  # messages


@dataclass(frozen=True, eq=False)
class RecordedClock:
    """What the simulated clock showed, `shown` (n,) ns, at the instants `recorded` (n,) ns."""

    recorded: NDArray[np.int64]
    shown: NDArray[np.int64]

    @classmethod
    def of(cls, topics: RecordedTopics) -> RecordedClock | None:
        """Return the clock of a recording; None where time was not simulated."""
        for received in topics.of_type(CLOCK).values():
            if len(received) >= _LEAST:
                pairs = [(item.stamp, nanoseconds_of(item.message.clock)) for item in received]
                recorded, shown = np.array(sorted(pairs), dtype=np.int64).T
                return cls(recorded, shown)
        return None

    @property
    def speed(self) -> float:
        """Return the simulated time relative to real time, over the whole recording."""
        elapsed = int(self.recorded[-1] - self.recorded[0])
        return int(self.shown[-1] - self.shown[0]) / elapsed if elapsed > 0 else 1.0

    def instant(self, stamp: int) -> int:
        """Return what the clock showed at an instant [ns] of the computer's own clock."""
        index = int(np.clip(np.searchsorted(self.recorded, stamp), 1, self.recorded.size - 1))
        nearest = index if stamp >= self.recorded[index] else index - 1
        return int(self.shown[nearest]) + round((stamp - int(self.recorded[nearest])) * self.speed)
