# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

import math

import numpy as np
import pytest
from tdm_planner.tracking.pendulum_tracking import PendulumTracker, PendulumTrackerParameters
from tdm_planner.tracking.repetition import RepetitionWatch
from tdm_planner.tracking.tracker import Phase

DT = 0.005
HANGING = np.array([math.pi, 0.0, 0.0, 0.0])


class Sensor:
    """A watch on a pendulum, fed with samples 5 ms apart under a torque."""

    def __init__(self) -> None:
        tracker = PendulumTracker(PendulumTrackerParameters())
        self.history = tracker.history
        self.watch = RepetitionWatch(tracker.estimator, 0.1)
        self.move = tracker.estimator.move
        self.time = 0.0

    def show(self, state: np.ndarray, torque: float) -> bool:
        self.history.add(self.time, np.array([torque]))
        self.time += DT
        self.watch.observe(state, self.time)
        return self.watch.stuck

    def until_stuck(self, state: np.ndarray, torque: float, longest: float = 1.0) -> float:
        begin = self.time
        while self.time - begin < longest:
            if self.show(state, torque):
                return self.time - begin
        return math.inf


@pytest.mark.parametrize(
    ('state', 'torque', 'within'),
    [
        (HANGING, 0.01, 0.11),
        (np.array([0.3, 0.1, -8.0, 4.0]), 1e-9, 0.11),
        (np.array([0.01, 0.0, 0.0, 0.0]), 0.001, 0.42),
    ],
)
def test_a_sensor_that_repeats_itself_is_stuck(
    state: np.ndarray, torque: float, within: float
) -> None:
    sensor = Sensor()
    for k in range(30):
        assert not sensor.show(state + 1e-6 * k, torque)
    assert sensor.until_stuck(state, torque) < within


def test_a_plant_that_moves_or_rests_is_not() -> None:
    sensor = Sensor()
    assert sensor.until_stuck(HANGING, 0.0, 2.0) == math.inf
    # nobody drives it: whether it rests or the sensor repeats itself is no matter
    assert sensor.until_stuck(np.array([0.5, 0.0, 0.0, 0.0]), 0.0, 2.0) == math.inf
    state = HANGING
    for _ in range(200):
        state = sensor.move(state, np.array([0.01]), DT)
        assert not sensor.show(state, 0.01)


def test_it_stays_stuck_without_torque_until_it_shows_another_number() -> None:
    sensor = Sensor()
    state = np.array([0.005, 0.0, 0.0, 0.0])
    assert sensor.until_stuck(state, 0.02) < 0.3
    for _ in range(300):
        assert sensor.show(state, 0.0)
    assert not sensor.show(state + 1e-3, 0.0)


def test_it_is_let_go_where_the_plant_should_rest_without_torque() -> None:
    sensor = Sensor()
    assert sensor.until_stuck(HANGING, 0.02) < 0.3
    shown = [sensor.show(HANGING, 0.0) for _ in range(100)]
    assert shown[0]
    assert not shown[-1]


def test_a_gap_of_any_length_is_no_matter() -> None:
    """Not integrated over: an hour took minutes, a leap of simulated time for ever."""
    sensor = Sensor()
    assert not sensor.show(HANGING, 0.02)
    sensor.time += 1.7e9
    assert not sensor.show(HANGING, 0.02)
    assert sensor.until_stuck(HANGING, 0.02) < 0.3


def test_the_tracker_commands_nothing_then() -> None:
    tracker = PendulumTracker(PendulumTrackerParameters())
    tracker.phase = Phase.RECOVERING
    state, problems = np.array([math.pi, 0.8, 0.0, 0.0]), []
    for k in range(60):
        tracker.observe(state, DT * k)
        command = tracker.command(DT * k)
        problems.append(command.problem)
        assert bool(command.control.any()) == ('sensor stuck' not in command.problem)
    assert 'sensor stuck' not in problems[5]
    assert 'sensor stuck' in problems[25]
