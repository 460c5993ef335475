# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The plans that a tracker is offered, looked at as far as its commands leave it time."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any, NamedTuple

from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.messages import nanoseconds_of, stamp_of

# Of a flood of plans as many are looked at as leave the commands their rate; the newest waits, but
# not longer than until shortly before its start.
_SHARE = 0.01  # of the time
_RESERVE = 0.15  # s; some ten plans
_IMMINENT = 0.15  # s before its start
_WORTH_IN_LEAD = 0.5  # s that may be overdrawn for plans whose start is to be prepared
_WORTH_AT_START = 1.0  # s, for plans about to start


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


class Offer(NamedTuple):
    """
    A trajectory that has arrived, as it came.

    To take one apart costs milliseconds, which a plan that is replaced at once is not worth.
    """

    stamp: Any
    data: bytes


class PlanIntake:
    """
    Hands plans to `look_at`, none while the node is not `ready`.

    The newest one waits until then, and while more have been offered than can be looked at beside
    the commands. `lead` is the time [s] before a start for which something is to be done.
    """

    def __init__(
        self,
        clock: MotionClock,
        ready: Callable[[], bool],
        lead: Callable[[], float],
        look_at: Callable[[Offer], None],
    ) -> None:
        self._clock, self._ready, self._lead, self._look_at = clock, ready, lead, look_at
        self._ration = Ration(_SHARE, _RESERVE, time.monotonic)
        self._waiting: Offer | None = None

    def instant(self, stamp: Any) -> float:
        """Instant of a time stamp [s]; stamps of zero mean now, as usual in ROS."""
        nanoseconds = nanoseconds_of(stamp)
        return self._clock.instant(nanoseconds) if nanoseconds else self._clock.now()

    def offer(self, data: bytes) -> None:
        """
        Take a plan as it came.

        Raises
        ------
        InvalidProblem
            If it does not even have a stamp.

        """
        offer, waiting = Offer(stamp_of(data), data), self._waiting
        self._waiting = offer
        ready = self._ready() and self._clock.runs
        if (
            ready
            and waiting is not None
            and self.instant(offer.stamp) < self.instant(waiting.stamp)
        ):
            # Of several planners' plans the one before may be the one to keep.
            if self._ration.allows:
                self._take(waiting)
            else:
                self._waiting = waiting
        self.look()

    def look(self) -> None:
        """Look at the plan that waits, if there is time for it."""
        offer = self._waiting
        if offer is None or not self._ready() or not self._clock.runs:
            return
        if self._ration.allows or self._ration.overdrawn < self._worth(offer):
            self._waiting = None
            self._take(offer)

    def clear(self) -> None:
        """Forget the plan that waits."""
        self._waiting = None

    def _worth(self, offer: Offer) -> float:
        """How much more time than there is may go into looking at a plan [s]."""
        if nanoseconds_of(offer.stamp) == 0:
            return 0.0  # it means now, whenever that is: it can wait
        wait = self.instant(offer.stamp) - self._clock.now()
        if abs(wait) < _IMMINENT:
            return _WORTH_AT_START
        return _WORTH_IN_LEAD if 0.0 < wait < self._lead() else 0.0

    def _take(self, offer: Offer) -> None:
        began = time.perf_counter()
        try:
            self._look_at(offer)
        finally:
            self._ration.spent(time.perf_counter() - began)
