# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Time as a plant in motion knows it, whatever happens to the clock that stamps are taken from."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import cast

from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node
from tdm_planner.trajectory import NANOSECOND

NO_TIME = 'simulated time is not known yet (use_sim_time): nothing has come on /clock'

_SMALLEST_STEP = 1_000_000  # ns; less is the jitter of reading two clocks
_QUICK = 500_000  # ns that reading them may take, lest a pause between looks like a step


def ros_clock(node: Node) -> ROSClock:
    """Return the node's clock, which is of more than the type that rclpy declares."""
    return cast(ROSClock, node.get_clock())


def pacing_clock(node: Node) -> Clock:
    """Return the clock for a node's timers: one that is set back would keep them from firing."""
    clock = ros_clock(node)
    if clock.ros_time_is_active:
        return clock
    return Clock(clock_type=ClockType.STEADY_TIME)


class MotionClock:
    """
    Seconds since the node began, by a clock that nobody sets.

    A computer's time of day is set, by hand or by a time daemon, while the plant neither stands
    still nor leaps. Stamps are therefore turned into instants of a steady clock, by the difference
    between both clocks as it is now; a step of the time of day is told to `on_step` [s].

    With `use_sim_time` the simulated clock is the plant's own, with its pauses and its speed:
    instants are then its seconds.
    """

    def __init__(self, node: Node, on_step: Callable[[float], None] | None = None) -> None:
        self._clock = ros_clock(node)
        self._on_step = on_step
        self._simulated = bool(self._clock.ros_time_is_active)
        self._begin = time.monotonic_ns()
        self._offset = int(self._clock.now().nanoseconds) - self._begin
        self._simulated_begin = self._begin + self._offset

    @property
    def runs(self) -> bool:
        """Whether the time is known: simulated time is not until a message came on `/clock`."""
        clock = self._clock
        return not clock.ros_time_is_active or bool(clock.now().nanoseconds > 0)

    def now(self) -> float:
        """Present instant [s]."""
        if self._clock.ros_time_is_active:
            self._simulated = True
            return self.instant(int(self._clock.now().nanoseconds))
        self._simulated = False
        before = time.monotonic_ns()
        stamp = int(self._clock.now().nanoseconds)
        steady = time.monotonic_ns()
        if steady - before < _QUICK:
            self._compare(stamp - (before + steady) // 2)
        return (steady - self._begin) * NANOSECOND

    def instant(self, stamp: int) -> float:
        """Instant [s] of a stamp [ns] of the node's clock."""
        if self._simulated:
            return (stamp - self._simulated_begin) * NANOSECOND
        return (stamp - self._offset - self._begin) * NANOSECOND

    def _compare(self, offset: int) -> None:
        step = offset - self._offset
        if abs(step) < _SMALLEST_STEP:
            return
        self._offset = offset
        if self._on_step is not None:
            self._on_step(step * NANOSECOND)
