# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What viewers are told to draw: colours, plants in motion, plans."""

from __future__ import annotations

import math
from typing import Any

from acrobot import Acrobot
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from marker_checks import check_markers, Scene
import numpy as np
import pytest
from replays import pendulum_points
from tdm_planner.drawing import arena_drawing, Drawn, PendulumDrawing, RobotDrawing
from tdm_planner.nodes.markers import DrawnPath, LONGEST_PATH, Picture, plan_markers
from tdm_planner.plant_views import view_of
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from visualization_msgs.msg import Marker, MarkerArray

PLANT = RotaryPendulum()
PENDULUM, ROBOT = PendulumDrawing(PLANT, 0.02, 2.0), RobotDrawing(0.4, 1.05, 0.15)
number = st.floats(-20.0, 20.0)


def place(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def shown(drawn: Drawn, state: Any, thrust: float = 0.0) -> Scene:
    state = np.array(state, dtype=float)
    return Scene(Picture(drawn, 1.0).draw(Time(), state, np.array([thrust, 0.0, 0.0])))


@pytest.mark.parametrize(
    ('drawn', 'name', 'always'),
    [
        (PENDULUM, '', {('body', 0), ('body', 1), ('force', 2)}),
        (ROBOT, 'robot2', {('body', 0), ('body', 1), ('reach', 2), ('force', 3), ('name', 0)}),
    ],
    ids=['pendulum', 'robot'],
)
@given(states=st.lists(st.lists(number, min_size=7, max_size=7), min_size=1, max_size=12))
@settings(max_examples=15)
def test_every_picture_is_valid_with_the_same_names(drawn, name, always, states) -> None:
    picture, scene = Picture(drawn, 60.0, name), Scene()
    for k, values in enumerate(states):
        state = np.array(values)
        picture.add(float(k), state)
        array = picture.draw(Time(sec=k), state, state[:3], lifetime=3.0)
        check_markers(array, drawn.kind.frame, 3.0)
        scene.apply(array)
        trail = {key for key in scene.names if key[0] == 'trail'}
        assert (scene.names - trail, len(trail)) == (always, int(k > 0))
        assert all(m.header.stamp.sec == k for m in array.markers)


@given(number, number)
@settings(max_examples=30)
def test_a_rod_is_where_the_state_has_it(theta, psi) -> None:
    scene = shown(PENDULUM, [theta, psi, 0.0, 0.0])
    pivot, tip = pendulum_points(PLANT, np.array(theta), np.array(psi))
    np.testing.assert_allclose(
        [place(p) for p in scene['body', 1].points], [pivot, tip], atol=1e-9
    )
    np.testing.assert_allclose(place(scene['body', 0].points[1]), pivot, atol=1e-9)


def test_a_jet_leaves_against_the_force_of_the_thruster() -> None:
    state = np.array([1.0, 2.0, 0.0, 0.0, 0.7, 0.0, 1.1])
    scene = shown(ROBOT, state, thrust=0.5)
    force = FloatingRobot().derivative(state, np.array([0.5, 0.0, 0.0]))[2:4]
    begin, end = np.array([place(p)[:2] for p in scene['force', 3].points])
    away = begin - state[:2]
    np.testing.assert_allclose(away / 0.15, -force / np.linalg.norm(force), atol=1e-9)
    np.testing.assert_allclose(end - state[:2], away * (1.0 + 1.6 * 0.5 / 1.05))
    heading = scene['body', 1].points[1]
    assert math.atan2(heading.y - 2.0, heading.x - 1.0) == pytest.approx(0.7)
    assert scene['body', 0].scale.x == pytest.approx(0.3)
    ring = [math.hypot(p.x - 1.0, p.y - 2.0) for p in scene['reach', 2].points]
    np.testing.assert_allclose(ring, 0.2)


def test_lines_are_as_thick_whichever_way_a_plant_points() -> None:
    acrobot = view_of(Acrobot())
    hanging, level = (shown(acrobot, [angle, 0.0, 0.0, 0.0]) for angle in (0.0, math.pi / 2))
    assert hanging['body', 0].scale.x == pytest.approx(level['body', 0].scale.x)


def test_a_trail_follows_keeps_its_distance_and_forgets() -> None:
    picture, theta = Picture(PENDULUM, 0.5), np.linspace(0.0, 1.0, 201)
    for k, value in enumerate(theta):
        picture.add(0.005 * k, np.array([value, 0.3, 0.0, 0.0]))

    def trail() -> list[list[float]]:
        scene = Scene(picture.draw(Time(), np.array([1.0, 0.3, 0.0, 0.0]), np.zeros(1)))
        return [place(p) for p in scene['trail', 1].points] if 'trail' in scene.namespaces else []

    _, tips = pendulum_points(PLANT, theta, np.array(0.3))
    np.testing.assert_allclose(trail(), tips[100::4], atol=1e-9)
    picture.add(-7.0, np.zeros(4))  # the clock went back
    assert trail() == []
    picture.add(-6.98, np.zeros(4))
    assert len(trail()) == 2
    picture.clear()
    assert trail() == []


STATES = np.zeros((1000, 7))
STATES[:, :2] = np.linspace([0.5, 0.5], [3.0, 1.0], 1000)
STATES[:, 4] = 0.5
ZONES = [[1.0, 2.0, 0.3], [4.0, 1.0, 0.2]]


def formation(names: str, zones: list[list[float]]) -> MarkerArray:
    ways = [DrawnPath(ROBOT, STATES if name != 'a' else STATES[-1:], name) for name in names]
    return plan_markers('arena', arena_drawing(5.0, 3.0, 0.4, zones), ways)


def test_a_plan_is_shown_with_its_surroundings_and_replaces_the_one_before() -> None:
    array = formation('abc', ZONES)
    check_markers(array, 'arena', 0.0)
    assert array.markers[0].action == Marker.DELETEALL
    scene = Scene(array)
    corners = {(p.x, p.y) for p in scene['body', 0].points}
    assert corners == {(0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (0.0, 3.0)}
    zone = scene['limit', 3]
    assert (zone.pose.position.x, zone.pose.position.y, zone.scale.x) == (4.0, 1.0, 0.4)
    goal, heading = scene['goal', 200].pose.position, scene['goal', 201].points
    assert (goal.x, goal.y) == (3.0, 1.0)
    turned = math.atan2(heading[1].y - 1.0, heading[1].x - 3.0)
    assert turned == pytest.approx(0.5)
    ring = [math.hypot(p.x - 3.0, p.y - 1.0) for p in scene['reach', 302].points]
    np.testing.assert_allclose(ring, 0.2)
    path = scene['planned_path', 300].points  # thinned, but with its ends
    assert (len(path), path[0].x, path[-1].x) == (LONGEST_PATH, 0.5, 3.0)
    # Of the first robot only the goal is known.
    paths = {number for name, number in scene.names if name == 'planned_path'}
    assert paths == {200, 300}
    last = formation('ab', [])
    scene.apply(last)
    assert scene.names == Scene(last).names
    assert ('goal', 300) not in scene.names
