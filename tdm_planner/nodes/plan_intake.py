# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Limits the time that a tracker spends on incoming plans: its commands must keep their rate."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from tdm_planner.nodes.clocks import MotionClock
from tdm_planner.nodes.reading import nanoseconds_of

# A flood of plans must not slow the commands down: plans beyond the time budget are dropped. The
# newest one waits, at most until shortly before its start.
_SHARE = 0.01  # of the time
_RESERVE = 0.15  # s; some ten plans
_IMMINENT = 0.15  # s before its start
_WORTH_IN_LEAD = 0.5  # s beyond the budget for a plan whose start must be prepared
_WORTH_AT_START = 1.0  # s beyond the budget for a plan about to start


class TimeBudget:
    """
    A time budget: a `reserve` [s] to begin with, refilled by a `share` of the time that passes.

    Ask what is `left` [s], less than nothing if it is overdrawn, and report what was `spent`.
    `clock` returns seconds.
    """

    def __init__(self, share: float, reserve: float, clock: Callable[[], float]) -> None:
        self._share, self._reserve, self._clock = share, reserve, clock
        self._paid = clock() - reserve / share  # instant up to which the share is spent [s]

    @property
    def left(self) -> float:
        """Time that may be spent now [s]."""
        now = self._clock()
        self._paid = max(self._paid, now - self._reserve / self._share)
        return self._share * (now - self._paid)

    def spent(self, seconds: float) -> None:
        """Subtract the time of work; it may exceed what was left."""
        self._paid += seconds / self._share


class PlanIntake:
    """
    Hands the newest plan received, the one `waiting`, to `look_at`, once there is time for it.

    A plan is the stamp and the serialised form of its message: deserialising costs milliseconds,
    and a plan that is superseded at once is not deserialised.
    """

    def __init__(self, clock: MotionClock, look_at: Callable[[Any, bytes], None]) -> None:
        self._clock, self._look_at = clock, look_at
        self._budget = TimeBudget(_SHARE, _RESERVE, time.monotonic)
        self.waiting: tuple[Any, bytes] | None = None

    def look(self, lead: float) -> None:
        """Look at the plan that waits; one needs the time `lead` [s] before its start."""
        if self.waiting is None or not self._clock.runs:
            return
        stamp, data = self.waiting
        left = self._budget.left
        if left <= 0.0 and left + self._worth(stamp, lead) <= 0.0:
            return
        self.waiting = None
        began = time.perf_counter()
        self._look_at(stamp, data)
        self._budget.spent(time.perf_counter() - began)

    def _worth(self, stamp: Any, lead: float) -> float:
        """Return by how much a plan may exceed the budget [s]; a start of now can wait."""
        if nanoseconds_of(stamp) == 0:
            return 0.0
        wait = self._clock.instant_of(stamp) - self._clock.now()
        if abs(wait) < _IMMINENT:
            return _WORTH_AT_START
        return _WORTH_IN_LEAD if 0.0 < wait < lead else 0.0
