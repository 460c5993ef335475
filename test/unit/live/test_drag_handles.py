# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Drag handles: where they stand for parameters, and which parameters put them where."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.plant_views import view_of
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_sim.live.drag_handles import drag_handles_of, pulled
from tdm_sim.live.geometry import about, axes_of

angle = st.floats(-6.0, 6.0)


@given(st.floats(0.5, 3.5), st.floats(2.9, 3.5), st.floats(-3.0, 3.0))
def test_a_robot_s_goal_goes_where_it_is_dragged(x: float, y: float, yaw: float) -> None:
    problem = RobotFormation()
    handle = drag_handles_of(problem)[1]
    wanted = handle.values_at((np.array([x, y, 0.0]), about((0, 0, 1), yaw)), {})
    moved = RobotFormation.from_parameters(wanted)
    place, turn = drag_handles_of(moved)[1].pose({})
    assert place == pytest.approx([x, y, 0.0])
    assert axes_of(turn)[0] == pytest.approx([math.cos(yaw), math.sin(yaw), 0.0], abs=1e-9)
    assert list(wanted) == ['formation.robot2']


@given(angle, angle)
def test_the_pendulum_s_rings_stand_for_its_angles(theta: float, psi: float) -> None:
    values = {'initial.theta': theta, 'initial.psi': psi}
    for handle in drag_handles_of(PendulumSwingUp()):
        assert (handle.node, handle.moves) == ('plant', 'turn')
        (found,) = handle.values_at(handle.pose(values), values).items()
        assert found[1] == pytest.approx(values[found[0]], abs=1e-7)


def test_the_ring_of_the_pendulum_points_along_the_rod() -> None:
    problem = PendulumSwingUp()
    view, values = view_of(problem), {'initial.theta': 0.7, 'initial.psi': -0.4}
    states = {'theta': np.float64(0.7), 'psi': np.float64(-0.4)}
    _, rod = view.drawing(states, {})
    pivot, tip = (np.array(point, dtype=float) for point in rod.points)
    place, turn = drag_handles_of(problem)[1].pose(values)
    assert place == pytest.approx(pivot)
    assert axes_of(turn)[0] == pytest.approx((tip - pivot) / np.linalg.norm(tip - pivot))


def test_a_turn_goes_on_from_the_turn_before() -> None:
    handle = drag_handles_of(PendulumSwingUp())[0]
    (psi,) = handle.values_at((np.zeros(3), about((0, 0, 1), -3.1)), {'initial.psi': 3.1}).values()
    assert psi == pytest.approx(2 * math.pi - 3.1)


def test_a_push_goes_where_the_body_was_pulled() -> None:
    robots = pulled(RobotFormation(), {}, np.zeros(7), (1, 1, 0), (1, 3, 0.5))
    assert robots == {'disturbance.direction': pytest.approx(math.pi / 2)}
    values = {'disturbance.impulse': 2e-4}
    for end, sign in (((0, 1, 0), 1.0), ((0, -1, 0), -1.0)):
        found = pulled(PendulumSwingUp(), values, np.zeros(4), (0, 0, 0), end)
        assert found == {'disturbance.impulse': sign * 2e-4}
