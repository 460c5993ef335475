# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Instants by a steady clock, with a stand-in for a node's clock that can be set."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest
from tdm_planner.nodes.motion_clock import MotionClock, pacing_clock

SECOND = 10**9


class SetClock:
    """The time of day, set by `offset` ns; or simulated."""

    def __init__(self) -> None:
        self.offset = 0
        self.ros_time_is_active = False
        self.simulated = 0

    def now(self) -> Any:
        real = time.monotonic_ns() + 10**18 + self.offset
        return SimpleNamespace(nanoseconds=self.simulated if self.ros_time_is_active else real)


@pytest.fixture
def clock() -> SetClock:
    return SetClock()


def node_with(clock: SetClock) -> Any:
    return SimpleNamespace(get_clock=lambda: clock)


def look(motion: MotionClock, clock: SetClock) -> tuple[float, float]:
    """Return the present instant, and what becomes of a stamp taken now."""
    now = motion.now()
    return now, motion.instant(clock.now().nanoseconds)


@pytest.mark.parametrize('step', [5.0, -5.0, 0.02, -86400.0])
def test_a_clock_that_is_set_moves_no_instant(clock: SetClock, step: float) -> None:
    steps: list[float] = []
    motion = MotionClock(node_with(clock), steps.append)
    before, stamped = look(motion, clock)
    assert stamped == pytest.approx(before, abs=0.01)
    clock.offset += round(step * SECOND)
    # A look that is interrupted compares nothing: the next one does.
    deadline = time.monotonic() + 5.0
    while not steps and time.monotonic() < deadline:
        after, stamped = look(motion, clock)
    assert steps == [pytest.approx(step, abs=1e-3)]
    assert 0.0 <= after - before < 5.0
    assert stamped == pytest.approx(after, abs=0.01)


def test_instants_never_go_back(clock: SetClock) -> None:
    motion = MotionClock(node_with(clock))
    last = motion.now()
    for k in range(500):
        clock.offset += (-1) ** k * k * SECOND
        now = motion.now()
        assert now >= last
        last = now


def test_simulated_time_is_the_plants_own(clock: SetClock) -> None:
    clock.ros_time_is_active, clock.simulated = True, 1000 * SECOND
    motion = MotionClock(node_with(clock))
    assert pacing_clock(node_with(clock)) is clock
    assert motion.now() == 0.0
    clock.simulated = 1002 * SECOND
    assert motion.now() == pytest.approx(2.0)
    assert motion.instant(1005 * SECOND) == pytest.approx(5.0)


def test_timers_follow_a_clock_that_nobody_sets(clock: SetClock) -> None:
    from rclpy.clock import ClockType

    assert pacing_clock(node_with(clock)).clock_type == ClockType.STEADY_TIME
