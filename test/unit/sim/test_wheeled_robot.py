# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_sim.integrator import integrate
from tdm_sim.wheeled_robot import Walls, WheeledRobot

SETTINGS = settings(deadline=None, max_examples=25, derandomize=True)
PLANT = WheeledRobot(FloatingRobot())
REST = np.zeros(9)


@SETTINGS
@given(torque=st.floats(-0.02, 0.02), omega=st.floats(-2.0, 2.0), wheel=st.floats(-50.0, 50.0))
def test_the_wheel_takes_up_the_angular_momentum(
    torque: float, omega: float, wheel: float
) -> None:
    start = REST.copy()
    start[5], start[8] = omega, wheel
    end = integrate(PLANT, start, np.array([0.5, 1.0, torque]), 1.0, 0.01)
    before = PLANT.robot.angular_momentum(start[5], start[8])
    after = PLANT.robot.angular_momentum(end[5], end[8])
    assert after == pytest.approx(before, abs=1e-9)
    # Constant torque: the wheel's angle grows with the mean of its speeds.
    assert end[7] == pytest.approx(0.5 * (start[8] + end[8]), abs=1e-9)


def test_the_robot_moves_as_without_a_wheel() -> None:
    start = np.array([1.0, 2.0, 0.1, -0.2, 0.3, 0.4, 0.5, 6.0, 7.0])
    control = np.array([1.0, -0.5, 0.01])
    alone = integrate(PLANT.robot, start[:7], control, 2.0, 0.01)
    np.testing.assert_allclose(integrate(PLANT, start, control, 2.0, 0.01)[:7], alone, atol=1e-12)


def test_many_robots_at_once() -> None:
    states = np.random.default_rng(0).normal(size=(5, 9))
    control = np.array([1.0, -0.5, 0.01])
    np.testing.assert_allclose(
        PLANT.derivative(states, control), [PLANT.derivative(s, control) for s in states]
    )


def test_bounces_are_elastic_reported_and_stay_inside() -> None:
    hits: list[tuple[str, float]] = []
    walls = Walls(4.0, 2.0, 0.15, lambda axis, speed: hits.append((axis, speed)))
    state = np.array([2.0, 1.0, 1.3, -0.7, *REST[4:]])
    positions = []
    for _ in range(2000):
        state = integrate(PLANT, state, np.zeros(3), 0.005, after_step=walls)
        positions.append(state[:2])
    inside = np.array(positions)
    assert inside.min() >= 0.15
    assert (inside.max(axis=0) <= [3.85, 1.85]).all()
    np.testing.assert_allclose(np.abs(state[2:4]), [1.3, 0.7])
    # 10 s at constant speed between walls 3.7 and 1.7 m apart, from the middle.
    assert sum(axis == 'x' for axis, _ in hits) == int(1.3 * 10.0 / 3.7 + 0.5)
    assert sum(axis == 'y' for axis, _ in hits) == int(0.7 * 10.0 / 1.7 + 0.5)
    assert {round(speed, 9) for _, speed in hits} == {1.3, 0.7}


def test_no_contact_in_the_middle_or_when_leaving_a_wall() -> None:
    walls = Walls(4.0, 4.0, 0.15, lambda *_: pytest.fail('there is no collision'))
    middle = np.array([2.0, 2.0, 1.0, 1.0, *REST[4:]])
    np.testing.assert_array_equal(walls(middle), middle)
    leaving = np.array([0.1, 2.0, 1.0, 0.0, *REST[4:]])
    np.testing.assert_array_equal(walls(leaving), leaving)
