# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How much of a node's time goes into work that can wait."""

from __future__ import annotations

from collections.abc import Callable


class Ration:
    """
    A share of the time that passes, beyond a `reserve` [s] which it also fills up again.

    Ask whether it `allows` work, and tell it what was `spent` [s]. `clock` returns seconds.
    """

    def __init__(self, share: float, reserve: float, clock: Callable[[], float]) -> None:
        self._share, self._reserve, self._clock = share, reserve, clock
        self._left, self._at = reserve, clock()

    @property
    def allows(self) -> bool:
        """Whether there is any left."""
        now = self._clock()
        self._left = min(self._reserve, self._left + self._share * (now - self._at))
        self._at = now
        return self._left > 0.0

    @property
    def overdrawn(self) -> float:
        """How much more has been spent than there was [s]."""
        return 0.0 if self.allows else -self._left

    def spent(self, seconds: float) -> None:
        """Take note of work that has been done; it may have taken more than was left."""
        self._left -= seconds
