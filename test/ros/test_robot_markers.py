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

from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from marker_checks import check_markers, Scene
import numpy as np
import pytest
from tdm_planner.nodes.markers import LIFETIME
from tdm_planner.nodes.robot_markers import RobotLook, RobotPicture, RobotState, TRAIL_LIFETIME
from tdm_planner.plants.floating_robot import FloatingRobot

LOOK = RobotLook('robot2', radius=0.15, separation=0.4, thrust=1.05)
LIFETIMES = {
    **dict.fromkeys(('body', 'heading', 'separation', 'name', 'plume'), LIFETIME),
    'trail': TRAIL_LIFETIME * LIFETIME,
}
angle, place = st.floats(-20.0, 20.0), st.floats(-10.0, 10.0)
states = st.builds(RobotState, place, place, angle, angle, st.floats(0.0, 2.0))


def yaw(marker) -> float:
    q = marker.pose.orientation
    return 2 * math.atan2(q.z, q.w)


def in_arena(marker) -> np.ndarray:
    """Points of a marker (n, 2), from its own frame to that of the arena."""
    c, s = math.cos(yaw(marker)), math.sin(yaw(marker))
    points = np.array([[p.x, p.y] for p in marker.points]) @ np.array([[c, s], [-s, c]])
    return points + np.array([marker.pose.position.x, marker.pose.position.y])


@given(st.lists(states, min_size=1, max_size=12))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_every_picture_is_valid_with_the_same_names(motion) -> None:
    picture, scene = RobotPicture(LOOK, trail=60.0), Scene()
    for k, state in enumerate(motion):
        picture.add(1_000_000_000 * k, state.x, state.y)
        array = picture.draw(Time(sec=k), state)
        check_markers(array, 'arena', LIFETIMES)
        scene.apply(array)
        always = {(name, 0) for name in ('body', 'heading', 'separation', 'name')}
        assert always <= scene.names <= always | {('plume', 0), ('trail', 0)}
        assert (('plume', 0) in scene.names) == (state.thrust > 1.05e-3)


@given(states.filter(lambda state: state.thrust > 0.01))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_the_plume_points_along_the_force_and_leaves_behind(state) -> None:
    plume = Scene(RobotPicture(LOOK, 60.0).draw(Time(), state))['plume']
    motion = np.array([state.x, state.y, 0.0, 0.0, state.yaw, 0.0, state.alpha])
    rates = FloatingRobot().derivative(motion, np.array([state.thrust, 0.0, 0.0]))
    force = rates[2:4] / np.linalg.norm(rates[2:4])
    direction = [math.cos(yaw(plume)), math.sin(yaw(plume))]
    np.testing.assert_allclose(direction, force, atol=1e-9)
    along = (in_arena(plume) - [state.x, state.y]) @ force
    assert along.max() == pytest.approx(-LOOK.radius)
    length = along.max() - along.min()
    assert length == pytest.approx(4 * LOOK.radius * min(state.thrust / 1.05, 1.0))


def test_heading_and_body_are_those_of_the_state() -> None:
    scene = Scene(RobotPicture(LOOK, 60.0).draw(Time(), RobotState(1.0, 2.0, 0.7)))
    assert yaw(scene['heading']) == pytest.approx(0.7)
    for name in ('body', 'heading', 'separation'):
        where = scene[name].pose.position
        assert (where.x, where.y) == (1.0, 2.0)
    assert scene['separation'].scale.x == 0.4
    assert scene['body'].scale.x == 0.3
    assert scene['name'].text == 'robot2'
    assert scene['body'].color.r == scene['separation'].color.r


def test_discs_of_two_robots_touch_at_the_minimum_separation() -> None:
    a = Scene(RobotPicture(LOOK, 60.0).draw(Time(), RobotState(1.0, 1.0, 0.0)))['separation']
    b = Scene(RobotPicture(LOOK, 60.0).draw(Time(), RobotState(1.4, 1.0, 0.0)))['separation']
    gap = b.pose.position.x - a.pose.position.x - (a.scale.x + b.scale.x) / 2
    assert gap == pytest.approx(0.0)


def test_markers_drawn_seldom_stay_longer() -> None:
    picture = RobotPicture(LOOK, 60.0)
    picture.add(0, 0.0, 0.0)
    picture.add(1_000_000_000, 0.1, 0.0)
    array = picture.draw(Time(), RobotState(0.1, 0.0, 0.0), lifetime=3.0)
    check_markers(array, 'arena', {**dict.fromkeys(LIFETIMES, 3.0), 'trail': 12.0})


def test_the_trail_is_repeated_now_and_then() -> None:
    picture = RobotPicture(LOOK, 60.0)
    for k in range(20):
        picture.add(1_000_000_000 * k, 0.1 * k, 0.0)
    arrays = [picture.draw(Time(), RobotState(1.9, 0.0, 0.0)) for _ in range(11)]
    with_trail = [k for k, array in enumerate(arrays) if 'trail' in {m.ns for m in array.markers}]
    assert with_trail == [0, 5, 10]
    trail = Scene(arrays[0])['trail']
    np.testing.assert_allclose([p.x for p in trail.points], 0.1 * np.arange(20))
    picture.clear()
    assert 'trail' not in Scene(arrays[0], picture.draw(Time(), RobotState(0, 0, 0.0))).namespaces
