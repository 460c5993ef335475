# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Shapes as solids in space, what the camera sees of them, and handles to drag parameters by."""

from __future__ import annotations

import math

from hypothesis import assume, given
from hypothesis import strategies as st
import numpy as np
import pytest
from tdm_planner.drawing import Box, Disc, Line, Shape
from tdm_planner.plant_views import view_of
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_sim.live.geometry import about, axes_of, from_vertical, GHOST, Look, picture, view_on
from tdm_sim.live.scene import drag_handles_of, pulled

component = st.floats(-2.0, 2.0)
vector = st.tuples(component, component, component)


@given(vector)
def test_a_tube_lies_along_its_line(way: tuple[float, ...]) -> None:
    direction = np.array(way)
    assume(np.linalg.norm(direction) > 1e-3)
    _, _, along = axes_of(from_vertical(direction))
    assert along == pytest.approx(direction / np.linalg.norm(direction), abs=1e-7)


def test_what_a_shape_becomes() -> None:
    shapes: list[Shape] = [
        Line(((0.0, 0.0), (3.0, 4.0))),
        Disc((1.0, 2.0), 0.5, 'reach'),
        Disc((1.0, 2.0, 3.0), 0.5),
        Box((1.0, 2.0, 3.0), (1.0, 2.0, 4.0), math.pi / 2),
        Line(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), 'limit'),
    ]
    found = picture([(shapes, Look())], 0.1)
    assert {kind for kind, _ in found.solids} == {'cylinder', 'ball', 'box'}
    tube = found.solids['cylinder', 1.0]
    assert tube.places[0] == pytest.approx([1.5, 2.0, 0.0])
    assert tube.sizes[0] == pytest.approx([0.1, 0.1, 5.0])
    ((_, opacity),) = [kind for kind in found.solids if kind[1] < 1.0]
    assert found.solids['cylinder', opacity].sizes[0][:2] == pytest.approx([0.5, 0.5])
    assert found.solids['ball', 1.0].places[0] == pytest.approx([1.0, 2.0, 3.0])
    ahead, _, _ = axes_of(found.solids['box', 1.0].rotations[0])
    assert ahead == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert found.lines == pytest.approx(np.array([[[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [1, 1, 0]]]))
    assert found.line_colours.shape == found.lines.shape


def test_groups_keep_their_number_and_a_ghost_has_bodies_only() -> None:
    shapes: list[Shape] = [Disc((0.0, 0.0), 0.1), Line(((0.0, 0.0), (1.0, 0.0)), 'limit')]
    found = picture([(shapes, GHOST), (shapes, GHOST)], 0.1)
    ((_, solids),) = found.solids.items()
    assert solids.groups.tolist() == [0, 1]
    assert len(found.lines) == 0


@pytest.mark.parametrize('kind', [PendulumSwingUp, RobotFormation])
def test_built_in_plants_are_seen_whole(kind: type) -> None:
    view = view_of(kind())
    states = {name: np.float64(0.3) for name in view.kind.state_names}
    controls = {name: np.float64(0.01) for name in view.kind.control_names}
    shapes = [*view.surroundings(), *view.drawing(states, controls)]
    seen = view_on(shapes)
    found = picture([(shapes, Look())], seen.width)
    places = np.concatenate([solids.places for solids in found.solids.values()])
    assert np.linalg.norm(places - seen.target, axis=1).max() < seen.size
    assert 0.5 < np.linalg.norm(seen.camera - seen.target) / seen.size < 2.0
    assert places[:, 2].min() >= seen.floor - 1e-9


def test_what_moves_in_an_upright_plane_is_seen_from_the_front() -> None:
    upright = view_on([Line(((0.0, 0.0, 0.0), (3.0, 0.0, 2.0))), Disc((3.0, 0.0, 2.0), 0.2)])
    assert upright.camera[0] == upright.target[0]
    assert upright.camera[1] < -upright.size / 2
    deep = view_on([Line(((0.0, 0.0, 0.0), (3.0, 2.0, 2.0)))])
    assert deep.camera[0] > deep.target[0]


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
    assert isinstance(rod, Line)
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
