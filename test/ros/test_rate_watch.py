# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import pytest
from tdm_planner.nodes.rate_watch import RateWatch


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def ticked(nominal: float, actual: float, seconds: float) -> tuple[RateWatch, Clock]:
    clock = Clock()
    watch = RateWatch(nominal, clock)
    for _ in range(round(seconds * actual)):
        clock.now += 1.0 / actual
        watch.tick()
    return watch, clock


@pytest.mark.parametrize('rate', [1.0, 7.0, 50.0, 200.0, 1000.0])
def test_a_rate_that_is_held_is_no_problem(rate: float) -> None:
    watch, _ = ticked(rate, rate, 5.0)
    assert watch.problem() == ''
    assert watch.measured() == pytest.approx(rate, abs=0.51)


def test_a_rate_that_is_not_held_is_told() -> None:
    watch, _ = ticked(200.0, 143.0, 5.0)
    assert watch.problem() == '143 Hz instead of 200: the computer is too busy, lower the rate'


def test_a_stall_is_told_and_forgotten() -> None:
    watch, clock = ticked(200.0, 200.0, 5.0)
    clock.now += 1.0
    assert watch.measured() == pytest.approx(100.0, abs=1.0)
    assert watch.problem()
    for _ in range(400):
        clock.now += 1.0 / 200.0
        watch.tick()
    assert watch.problem() == ''


def test_nothing_is_told_while_a_node_starts() -> None:
    watch, clock = ticked(200.0, 20.0, 1.0)
    assert watch.problem() == ''
    clock.now += 1.5
    assert watch.problem()
