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

"""Resident memory of processes over time, and how fast it grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

KILOBYTE, MEGABYTE = 1024.0, 1024.0**2
HOUR = 3600.0


def resident(identifier: int) -> float:
    """Return the resident memory of a process [MB]; nan once it has ended."""
    try:
        status = Path(f'/proc/{identifier}/status').read_text()
    except (FileNotFoundError, ProcessLookupError):
        return float('nan')
    sizes = [line.split()[1] for line in status.splitlines() if line.startswith('VmRSS:')]
    return float(sizes[0]) * KILOBYTE / MEGABYTE if sizes else float('nan')


def growth(times: Sequence[float], sizes: Sequence[float], from_time: float) -> float:
    """
    Return the slope of sizes [MB] over times [s] after `from_time`, by least squares [MB/h].

    nan where there are fewer than three samples.
    """
    at, size = np.array(times), np.array(sizes)
    chosen = (at >= from_time) & np.isfinite(size)
    if np.count_nonzero(chosen) < 3:
        return float('nan')
    return float(np.polyfit(at[chosen], size[chosen], 1)[0] * HOUR)


@dataclass
class MemoryRecord:
    """Samples of the resident memory [MB] of processes, by name, at instants [s]."""

    times: list[float] = field(default_factory=list)
    sizes: dict[str, list[float]] = field(default_factory=dict)

    def sample(self, time: float, identifiers: Mapping[str, int]) -> None:
        """Take a sample of every process; always the same ones."""
        self.times.append(time)
        for name, identifier in identifiers.items():
            self.sizes.setdefault(name, []).append(resident(identifier))

    def growth(self, from_time: float) -> dict[str, float]:
        """Return every process's slope after `from_time` [MB/h]."""
        return {name: growth(self.times, sizes, from_time) for name, sizes in self.sizes.items()}
