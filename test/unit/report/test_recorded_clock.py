# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from types import SimpleNamespace

import pytest
from tdm_sim.report.recorded_clock import RecordedClock
from tdm_sim.report.recorded_topics import CLOCK, Received, RecordedTopics

SECOND = 10**9


def topics(count: int, speed: float) -> RecordedTopics:
    messages = []
    for k in range(count):
        shown = round(k * speed * SECOND)
        clock = SimpleNamespace(sec=100 + shown // SECOND, nanosec=shown % SECOND)
        messages.append(Received(SimpleNamespace(clock=clock), (50 + k) * SECOND))
    return RecordedTopics(
        streams={}, messages={'/clock': messages}, types={'/clock': CLOCK}, malformed={},
        not_finite={},
    )  # fmt: skip


@pytest.mark.parametrize('speed', [0.5, 1.0, 4.0])
def test_speed_and_instants(speed: float):
    clock = RecordedClock.of(topics(20, speed))
    assert clock is not None
    assert clock.speed == pytest.approx(speed)
    for recorded in (40.0, 50.0, 52.25, 69.0, 80.0):
        expected = 100 + (recorded - 50) * speed
        assert clock.instant(round(recorded * SECOND)) / SECOND == pytest.approx(expected)


@pytest.mark.parametrize('count', [0, 1])
def test_without_simulated_time_there_is_none(count: int):
    assert RecordedClock.of(topics(count, 4.0)) is None
