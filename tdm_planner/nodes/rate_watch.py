# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Whether a node keeps up with the rate it was given, for its diagnostics."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rclpy.clock import Clock
from tdm_planner.trajectory import NANOSECOND

_WINDOW = 2.0  # s over which the rate is counted
_SHARE = 0.9  # of the rate below which the node does not keep up


def seconds_by(clock: Clock) -> Callable[[], float]:
    """Return what tells the seconds of a ROS clock."""
    return lambda: float(clock.now().nanoseconds) * NANOSECOND


class RateWatch:
    """Counts ticks of a timer of `rate` Hz; `clock` returns the seconds that the timer goes by."""

    def __init__(self, rate: float, clock: Callable[[], float]) -> None:
        self.rate = rate
        self._clock = clock
        self._began = clock()
        self._ticks: deque[float] = deque()

    def tick(self) -> None:
        """Note that the timer has fired."""
        now = self._clock()
        self._ticks.append(now)
        self._forget(now)

    def measured(self) -> float:
        """Return the rate of the last two seconds, or since the beginning [Hz]."""
        now = self._clock()
        self._forget(now)
        return len(self._ticks) / max(min(now - self._began, _WINDOW), 1.0 / self.rate)

    def problem(self) -> str:
        """Return a sentence where the rate is not held, '' otherwise."""
        # At rates of a few Hz a tick more or less is no matter.
        measured = self.measured()
        if self._clock() - self._began < _WINDOW or measured + 1.0 / _WINDOW >= _SHARE * self.rate:
            return ''
        return (
            f'{measured:.0f} Hz instead of {self.rate:g}: the computer is too busy, lower the rate'
        )

    def _forget(self, now: float) -> None:
        while self._ticks and self._ticks[0] <= now - _WINDOW:
            self._ticks.popleft()
