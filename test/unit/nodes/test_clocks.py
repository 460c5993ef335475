# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Clocks set by hand: instants of motion, rates watched, work that gets a share of the time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from hypothesis import assume, given
from hypothesis import strategies as st
import pytest
from rclpy.clock import ClockType
from tdm_planner.nodes.clocks import MotionClock, pacing_clock, RateWatch
from tdm_planner.nodes.plan_intake import TimeBudget

SECOND = 10**9


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


# Work that can wait.


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def ration(clock: Clock) -> TimeBudget:
    return TimeBudget(0.01, 0.05, clock)


def test_the_reserve_is_used_up_and_comes_back(clock: Clock, ration: TimeBudget) -> None:
    assert ration.left == pytest.approx(0.05)
    ration.spent(0.06)
    assert ration.left == pytest.approx(-0.01)
    clock.now += 0.9
    assert ration.left == pytest.approx(-0.001)
    clock.now += 0.2
    assert ration.left == pytest.approx(0.001)
    clock.now += 3600.0  # no more than the reserve is saved
    assert ration.left == pytest.approx(0.05)


@given(work=st.floats(1e-3, 0.1), share=st.floats(0.005, 0.5), reserve=st.floats(1e-3, 1.0))
def test_in_the_long_run_it_is_the_share(work: float, share: float, reserve: float) -> None:
    clock = Clock()
    ration = TimeBudget(share, reserve, clock)
    done, span, step = 0.0, 60.0, 1e-2
    assume(min(work, reserve) >= share * step)  # there is more to do than the share allows
    for _ in range(round(span / step)):
        clock.now += step
        if ration.left > 0.0:
            ration.spent(work)
            done += work
    assert share * (span - 2 * step) <= done <= share * span + reserve + work


# Rates.


def tick(watch: RateWatch, clock: Clock, rate: float, count: int) -> None:
    for _ in range(count):
        clock.now += 1.0 / rate
        watch.tick()


@pytest.mark.parametrize('rate', [1.0, 7.0, 50.0, 200.0, 1000.0])
def test_a_rate_that_is_held_is_no_problem(clock: Clock, rate: float) -> None:
    watch = RateWatch(rate, clock)
    tick(watch, clock, rate, round(5 * rate))
    assert watch.problem() == ''
    assert watch.measured() == pytest.approx(rate, abs=0.51)


def test_a_rate_that_is_not_held_is_told(clock: Clock) -> None:
    watch = RateWatch(200.0, clock)
    tick(watch, clock, 143.0, 715)
    assert watch.problem() == '143 Hz instead of 200: the computer is too busy, lower the rate'


def test_a_stall_is_told_and_forgotten(clock: Clock) -> None:
    watch = RateWatch(200.0, clock)
    tick(watch, clock, 200.0, 1000)
    clock.now += 1.0
    assert watch.measured() == pytest.approx(100.0, abs=1.0)
    assert watch.problem()
    tick(watch, clock, 200.0, 400)
    assert watch.problem() == ''


def test_nothing_is_told_while_a_node_starts(clock: Clock) -> None:
    watch = RateWatch(200.0, clock)
    tick(watch, clock, 20.0, 20)
    assert watch.problem() == ''
    clock.now += 1.5
    assert watch.problem()


# Instants of motion.


class SetClock:
    """A steady clock, and the time of day, set by `offset` ns; or simulated."""

    def __init__(self) -> None:
        self.offset = self.simulated = self.took = 0
        self.steady = 7 * SECOND
        self.ros_time_is_active = False

    def monotonic_ns(self) -> int:
        self.steady += self.took
        return self.steady

    def now(self) -> Any:
        real = self.steady + 10**18 + self.offset
        return SimpleNamespace(nanoseconds=self.simulated if self.ros_time_is_active else real)

    def get_clock(self) -> Any:
        return self


@pytest.fixture
def day(monkeypatch: pytest.MonkeyPatch) -> Any:
    made = SetClock()
    monkeypatch.setattr('tdm_planner.nodes.clocks.time', made)
    return made


@pytest.mark.parametrize('step', [5.0, -5.0, 0.02, 0.001, -86400.0])
def test_a_clock_that_is_set_moves_no_instant(day: Any, step: float) -> None:
    steps: list[float] = []
    motion = MotionClock(day, steps.append)
    assert motion.now() == 0.0
    day.steady += SECOND
    assert motion.instant(day.now().nanoseconds) == motion.now() == 1.0
    day.offset += round(step * SECOND)
    assert motion.now() == 1.0
    assert steps == [pytest.approx(step)]
    assert motion.instant(day.now().nanoseconds) == 1.0
    assert motion.now() == 1.0
    assert len(steps) == 1


@pytest.mark.parametrize(
    ('offset', 'took', 'steps'), [(999_999, 0, 0), (SECOND, 499_999, 1), (SECOND, 500_000, 0)]
)
def test_jitter_and_a_look_that_is_interrupted_compare_nothing(
    day: Any, offset: int, took: int, steps: int
) -> None:
    told: list[float] = []
    motion = MotionClock(day, told.append)
    day.offset, day.took = offset, took
    assert motion.now() == pytest.approx(2 * took * 1e-9)
    assert len(told) == steps


def test_simulated_time_is_the_plants_own(day: Any) -> None:
    day.ros_time_is_active = True
    motion = MotionClock(day)
    assert not motion.runs
    day.simulated = 1000 * SECOND
    motion = MotionClock(day)
    assert motion.runs
    assert pacing_clock(day) == day
    assert motion.now() == 0.0
    day.simulated = 1002 * SECOND
    assert motion.now() == pytest.approx(2.0)
    assert motion.instant(1005 * SECOND) == pytest.approx(5.0)


def test_timers_follow_a_clock_that_nobody_sets(day: Any) -> None:
    assert pacing_clock(day).clock_type == ClockType.STEADY_TIME
    assert MotionClock(day).runs
