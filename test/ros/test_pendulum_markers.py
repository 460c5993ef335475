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
from tdm_planner.nodes.pendulum_markers import LONGEST_PATH, PendulumPicture, plan_markers
from tdm_planner.plants.pendulum_geometry import pendulum_points
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.trajectory import Trajectory
from visualization_msgs.msg import Marker

PLANT = RotaryPendulum()
STATIC = {('base', 0), ('disk', 0), ('disk_limit', 0), ('arm', 0), ('rod', 0)}
angles = st.floats(-20.0, 20.0)


def position(point) -> list[float]:
    return [point.x, point.y, point.z]


def plan(count: int, end: float = 0.0) -> Trajectory:
    theta = np.linspace(math.pi, end, count)
    return Trajectory(
        times=np.linspace(0.0, 1.0, count),
        states=np.stack([theta, 0.1 * theta, 0 * theta, 0 * theta], axis=1),
        controls=np.zeros((count, 1)),
        state_names=('theta', 'psi', 'theta_dot', 'psi_dot'),
        control_names=('torque',),
    )


@given(st.lists(st.tuples(angles, angles), min_size=1, max_size=30))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_every_picture_is_valid_with_the_same_names(states) -> None:
    picture = PendulumPicture(PLANT, 2.0, trail=0.2)
    scene = Scene()
    for k, (theta, psi) in enumerate(states):
        picture.add(10_000_000 * k, theta, psi)
        array = picture.draw(Time(nanosec=10_000_000 * k), theta, psi)
        check_markers(array, 'world', LIFETIME)
        scene.apply(array)
        trail = {('trail', 0)} if k > 0 else set()
        assert scene.names == STATIC | trail
        assert all(m.header.stamp.nanosec == 10_000_000 * k for m in array.markers)


@given(angles, angles)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_rod_and_disk_are_where_the_state_has_them(theta, psi) -> None:
    picture = PendulumPicture(PLANT, 2.0, trail=1.0)
    scene = Scene(picture.draw(Time(), theta, psi))
    pivot, tip = pendulum_points(PLANT, np.array(theta), np.array(psi))
    np.testing.assert_allclose([position(p) for p in scene['rod'].points], [pivot, tip], atol=1e-9)
    q = scene['disk'].pose.orientation
    assert math.isclose(
        math.remainder(2 * math.atan2(q.z, q.w) - psi, 2 * math.pi), 0, abs_tol=1e-9
    )
    end = position(scene['arm'].points[1])
    np.testing.assert_allclose(end[:2], pivot[:2], atol=1e-9)


@pytest.mark.parametrize(
    ('limit', 'span'), [(0.5, 0.5), (2.0, 2.0), (3.5, math.pi), (1e12, math.pi)]
)
def test_the_arc_ends_at_the_limits_and_turns_red_beyond(limit, span) -> None:
    picture = PendulumPicture(PLANT, limit, trail=1.0)
    inside = Scene(picture.draw(Time(), 0.0, 0.9 * limit))['disk_limit']
    outside = Scene(picture.draw(Time(), 0.0, -1.1 * limit))['disk_limit']
    ends = [math.atan2(p.y, p.x) for p in (inside.points[0], inside.points[-1])]
    np.testing.assert_allclose(np.abs(ends), span, atol=1e-9)
    radii = [math.hypot(p.x, p.y) for p in inside.points]
    np.testing.assert_allclose(radii, 1.25 * PLANT.arm_length)
    assert inside.color != outside.color
    assert outside.color.r > outside.color.g


def test_the_trail_follows_the_tip_and_fades() -> None:
    picture = PendulumPicture(PLANT, 2.0, trail=0.5)
    theta = np.linspace(0.0, 1.0, 200)
    for k, value in enumerate(theta):
        picture.add(5_000_000 * k, float(value), 0.3)
    trail = Scene(picture.draw(Time(), 1.0, 0.3))['trail']
    _, tips = pendulum_points(PLANT, theta, np.array(0.3))
    np.testing.assert_allclose([position(p) for p in trail.points], tips[100::2], atol=1e-9)
    alphas = [colour.a for colour in trail.colors]
    assert alphas == sorted(alphas)
    assert alphas[-1] > 3 * alphas[0]
    picture.clear()
    assert 'trail' not in Scene(picture.draw(Time(), 1.0, 0.3)).namespaces


def test_a_new_plan_replaces_the_old_one() -> None:
    first, second = plan_markers(PLANT, plan(50)), plan_markers(PLANT, plan(2, end=2 * math.pi))
    check_markers(first, 'world', 0.0)
    check_markers(second, 'world', 0.0)
    assert first.markers[0].action == Marker.DELETEALL
    scene = Scene(first, second)
    assert scene.names == {('planned_path', 0), ('goal', 0)}
    assert len(scene['planned_path'].points) == 2
    _, tip = pendulum_points(PLANT, np.array(2 * math.pi), np.array(0.2 * math.pi))
    np.testing.assert_allclose(position(scene['goal'].pose.position), tip)


def test_the_path_is_thinned_but_keeps_its_ends() -> None:
    long = plan(5000)
    path = Scene(plan_markers(PLANT, long))['planned_path']
    assert len(path.points) == LONGEST_PATH
    _, tips = pendulum_points(PLANT, long.states[[0, -1], 0], long.states[[0, -1], 1])
    np.testing.assert_allclose([position(p) for p in (path.points[0], path.points[-1])], tips)
