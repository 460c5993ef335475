# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""A steady clock for plants in motion, and a check whether a node holds its rate."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
import threading
import time
from typing import Any

from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.timer import Timer
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.tracking.motion import CLOCK_TOLERANCE
from tdm_planner.trajectory import NANOSECOND

NO_TIME = 'simulated time is not known yet (use_sim_time): nothing has come on /clock'

_SMALLEST_STEP = 1_000_000  # ns; less is the jitter of reading two clocks
_QUICK = 500_000  # ns that reading them may take, lest a pause between looks like a step
_WINDOW = 2.0  # s over which a rate is counted
_SLOW = 0.9  # share of the rate below which a node does not keep up


def pacing_clock(node: Node) -> Clock:
    """Return the clock for a node's timers: one that is set back would keep them from firing."""
    clock: Clock = node.get_clock()
    return clock if clock.ros_time_is_active else Clock(clock_type=ClockType.STEADY_TIME)


def steady_timer(node: Node, period: float, callback: Callable[[], object]) -> Timer:
    """Make a timer [s] that also rings while simulated time stands still."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def watch_set_back(node: Node, callback: Callable[[TimeJump], None]) -> Any:
    """Call back when a node's clock is set back by more than trackers allow; keep the result."""
    least = Duration(nanoseconds=-1 - round(CLOCK_TOLERANCE / NANOSECOND))
    backwards = JumpThreshold(min_forward=None, min_backward=least, on_clock_change=False)
    return node.get_clock().create_jump_callback(backwards, post_callback=callback)


class MotionClock:
    """
    Seconds since the node began, by a clock that is never set.

    The time of day may be set, by hand or by a time daemon, while a plant moves. Stamps are
    therefore converted to instants of a steady clock, by the present difference of both clocks. A
    step of the time of day is reported to `on_step` [s].

    With `use_sim_time` the simulated clock is the plant's own, with its pauses and its speed.
    Instants are then seconds since the first stamp there was, on `/clock` or of a message.

    Safe in any thread.
    """

    def __init__(self, node: Node, on_step: Callable[[float], None] | None = None) -> None:
        self._clock = node.get_clock()
        self._on_step = on_step
        self._lock = threading.Lock()
        self._simulated = bool(self._clock.ros_time_is_active)
        self._begin = time.monotonic_ns()
        self._offset = int(self._clock.now().nanoseconds) - self._begin
        self._simulated_begin = self._begin + self._offset if self._simulated else 0

    @property
    def runs(self) -> bool:
        """Whether the time is known: simulated time is not until a message came on `/clock`."""
        clock = self._clock
        return not clock.ros_time_is_active or bool(clock.now().nanoseconds > 0)

    @property
    def problem(self) -> str:
        """Return a sentence where no time is known, '' otherwise."""
        return '' if self.runs else NO_TIME

    @property
    def _zero(self) -> int:
        """Stamp [ns] of the node's clock at the instant 0."""
        return self._simulated_begin if self._simulated else self._begin + self._offset

    def now(self) -> float:
        """Present instant [s]; without meaning until the time `runs`."""
        self._simulated = bool(self._clock.ros_time_is_active)
        if self._simulated:
            return self.instant(int(self._clock.now().nanoseconds))
        before = time.monotonic_ns()
        stamp = int(self._clock.now().nanoseconds)
        steady = time.monotonic_ns()
        offset = stamp - (before + steady) // 2
        step = offset - self._offset
        if steady - before < _QUICK and abs(step) >= _SMALLEST_STEP:
            self._offset = offset
            if self._on_step is not None:
                self._on_step(step * NANOSECOND)
        return (steady - self._begin) * NANOSECOND

    def instant(self, stamp: int) -> float:
        """Instant [s] of a stamp [ns] of the node's clock."""
        with self._lock:
            if self._simulated:
                self._simulated_begin = self._simulated_begin or stamp
        return (stamp - self._zero) * NANOSECOND

    def instant_of(self, stamp: Any) -> float:
        """Instant [s] of a message's time stamp; zero means now, as usual in ROS."""
        nanoseconds, now = nanoseconds_of(stamp), self.now()
        return self.instant(nanoseconds) if nanoseconds else now

    def stamp(self, instant: float) -> int:
        """Stamp [ns] of the node's clock at an instant [s]."""
        return self._zero + round(instant / NANOSECOND)


class RateWatch:
    """Counts ticks of a timer of `rate` Hz; `clock` is what the timer goes by."""

    def __init__(self, rate: float, clock: Clock) -> None:
        self.rate = rate
        self._clock = clock
        self._began = math.inf  # with the first tick: simulated time is 0 until /clock is heard
        self._ticks: deque[float] = deque(maxlen=math.ceil(_WINDOW * rate) + 1)

    def _now(self) -> float:
        now = float(self._clock.now().nanoseconds) * NANOSECOND
        if self._ticks and now < self._ticks[-1]:  # simulated time was set back
            self._ticks.clear()
            self._began = now
        return now

    def tick(self) -> None:
        """Note that the timer has fired."""
        now = self._now()
        self._began = min(self._began, now)
        self._ticks.append(now)

    def measured(self) -> float:
        """Return the rate of the last two seconds, or since the first [Hz]."""
        now = self._now()
        recent = sum(tick > now - _WINDOW for tick in self._ticks)
        return recent / max(min(now - self._began, _WINDOW), 1.0 / self.rate)

    def problem(self) -> str:
        """Return a sentence where the rate is not held, '' otherwise."""
        # At a few Hz, one tick more or less must not count.
        measured = self.measured()
        if self._now() - self._began < _WINDOW or measured + 1.0 / _WINDOW >= _SLOW * self.rate:
            return ''
        why = 'the computer is too busy, lower the rate'
        if getattr(self._clock, 'ros_time_is_active', False):
            why = f'/clock comes too seldom, or {why}'
        return f'{measured:.0f} Hz instead of {self.rate:g}: {why}'
