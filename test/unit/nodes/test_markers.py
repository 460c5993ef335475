# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What viewers are told to draw: colours, the pendulum, a robot, a formation."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from marker_checks import check_markers, Scene
import numpy as np
import pytest
from tdm_planner.nodes.formation_markers import formation_markers, LONGEST_PATH
from tdm_planner.nodes.markers import (
    colour_of,
    GREY,
    LIFETIME,
    lifetime_at,
    Pen,
    points_of,
    Trail,
)
from tdm_planner.nodes.pendulum_markers import LONGEST_PATH as LONGEST_PENDULUM_PATH
from tdm_planner.nodes.pendulum_markers import PendulumPicture, plan_markers
from tdm_planner.nodes.robot_markers import RobotLook, RobotPicture, TRAIL_LIFETIME
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.pendulum_geometry import pendulum_points
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.problems.formation_parameters import Arena
from tdm_planner.trajectory import Trajectory
from visualization_msgs.msg import Marker, MarkerArray


def rgb(name: str) -> tuple[float, float, float]:
    colour = colour_of(name)
    return colour.r, colour.g, colour.b


def test_a_name_has_one_colour_and_numbered_names_different_ones() -> None:
    assert rgb('robot2') == rgb('robot2')
    assert len({rgb(f'robot{k}') for k in range(1, 8)}) == 7
    assert len({rgb(name) for name in ('alice', 'bob', 'carol')}) > 1
    assert colour_of('robot' + '9' * 40).a == 1.0


def test_what_the_pen_draws_is_valid_and_deletes_by_name() -> None:
    pen = Pen('map', Time(sec=3), lifetime=1.5)
    line = pen.line('way', 4, points_of(np.eye(3)), GREY, 0.1)
    ball = pen.solid('ball', 0, Marker.SPHERE, GREY, (1.0, 2.0, 3.0), (4.0, 5.0))
    first = MarkerArray(markers=[line, ball, pen.text('note', 0, 'hello', (0.0, 1.0, 2.0), 0.2)])
    check_markers(first, 'map', 1.5)
    assert all(marker.header.stamp.sec == 3 for marker in first.markers)
    assert (ball.pose.position.x, ball.pose.position.y, ball.pose.position.z) == (4.0, 5.0, 0.0)
    scene = Scene(first, MarkerArray(markers=[pen.delete('way', 4)]))
    assert scene.names == {('ball', 0), ('note', 0)}
    scene.apply(MarkerArray(markers=[pen.delete_all(), line]))
    assert scene.names == {('way', 4)}
    for rate in (0.1, 1.0, 25.0, 100.0):
        assert 2 / rate < lifetime_at(rate) <= max(0.5, 5 / rate)


def test_a_trail_keeps_its_distance_and_forgets() -> None:
    trail = Trail(age=1.0, spacing=0.1)
    for k in range(301):
        trail.add(10_000_000 * k, 0.01 * k, 0.0, 0.0)
    found = [point.x for point in trail.points]
    np.testing.assert_allclose(found, np.arange(2.0, 3.05, 0.1))
    trail.add(10_000_000, 7.0, 0.0, 0.0)  # the clock went back
    assert [point.x for point in trail.points] == [7.0]
    trail.clear()
    assert trail.points == []


# The pendulum.

PLANT = RotaryPendulum()
STATIC = {('base', 0), ('disk', 0), ('disk_limit', 0), ('arm', 0), ('rod', 0)}
angles = st.floats(-20.0, 20.0)


def posed(theta: float, psi: float) -> np.ndarray:
    return np.array([theta, psi, 0.0, 0.0])


def drawn(
    picture: PendulumPicture, theta: float, psi: float, at: Time | None = None
) -> MarkerArray:
    return picture.draw(at or Time(), posed(theta, psi), np.zeros(1))


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
@settings(max_examples=30)
def test_every_picture_of_a_pendulum_is_valid_with_the_same_names(states) -> None:
    picture = PendulumPicture(PLANT, 2.0, trail=0.2)
    scene = Scene()
    for k, (theta, psi) in enumerate(states):
        picture.add(10_000_000 * k, posed(theta, psi))
        array = drawn(picture, theta, psi, Time(nanosec=10_000_000 * k))
        check_markers(array, 'world', LIFETIME)
        scene.apply(array)
        trail = {('trail', 0)} if k > 0 else set()
        assert scene.names == STATIC | trail
        assert all(m.header.stamp.nanosec == 10_000_000 * k for m in array.markers)


@given(angles, angles)
@settings(max_examples=30)
def test_rod_and_disk_are_where_the_state_has_them(theta, psi) -> None:
    picture = PendulumPicture(PLANT, 2.0, trail=1.0)
    scene = Scene(drawn(picture, theta, psi))
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
    inside = Scene(drawn(picture, 0.0, 0.9 * limit))['disk_limit']
    outside = Scene(drawn(picture, 0.0, -1.1 * limit))['disk_limit']
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
        picture.add(5_000_000 * k, posed(value, 0.3))
    trail = Scene(drawn(picture, 1.0, 0.3))['trail']
    _, tips = pendulum_points(PLANT, theta, np.array(0.3))
    np.testing.assert_allclose([position(p) for p in trail.points], tips[100::2], atol=1e-9)
    alphas = [colour.a for colour in trail.colors]
    assert alphas == sorted(alphas)
    assert alphas[-1] > 3 * alphas[0]
    picture.clear()
    assert 'trail' not in Scene(drawn(picture, 1.0, 0.3)).namespaces


def test_a_new_plan_replaces_the_old_one() -> None:
    long = plan(5000)
    first, second = plan_markers(PLANT, long), plan_markers(PLANT, plan(2, end=2 * math.pi))
    check_markers(first, 'world', 0.0)
    check_markers(second, 'world', 0.0)
    assert first.markers[0].action == Marker.DELETEALL
    points = Scene(first)['planned_path'].points  # thinned, but with its ends
    assert len(points) == LONGEST_PENDULUM_PATH
    _, tips = pendulum_points(PLANT, long.states[[0, -1], 0], long.states[[0, -1], 1])
    np.testing.assert_allclose([position(p) for p in (points[0], points[-1])], tips)
    scene = Scene(first, second)
    assert scene.names == {('planned_path', 0), ('goal', 0)}
    assert len(scene['planned_path'].points) == 2
    _, tip = pendulum_points(PLANT, np.array(2 * math.pi), np.array(0.2 * math.pi))
    np.testing.assert_allclose(position(scene['goal'].pose.position), tip)


# A robot.

LOOK = RobotLook('robot2', radius=0.15, separation=0.4, thrust=1.05)
LIFETIMES = {
    **dict.fromkeys(('body', 'heading', 'separation', 'name', 'plume'), LIFETIME),
    'trail': TRAIL_LIFETIME * LIFETIME,
}
angle, place = st.floats(-20.0, 20.0), st.floats(-10.0, 10.0)


def robot(x: float, y: float, yaw: float, alpha: float = 0.0) -> np.ndarray:
    return np.array([x, y, 0.0, 0.0, yaw, 0.0, alpha])


states = st.tuples(st.builds(robot, place, place, angle, angle), st.floats(0.0, 2.0))


def thrusting(thrust: float) -> np.ndarray:
    return np.array([thrust, 0.0, 0.0])


def yaw(marker) -> float:
    q = marker.pose.orientation
    return 2 * math.atan2(q.z, q.w)


def in_arena(marker) -> np.ndarray:
    """Points of a marker (n, 2), from its own frame to that of the arena."""
    c, s = math.cos(yaw(marker)), math.sin(yaw(marker))
    points = np.array([[p.x, p.y] for p in marker.points]) @ np.array([[c, s], [-s, c]])
    return points + np.array([marker.pose.position.x, marker.pose.position.y])


@given(st.lists(states, min_size=1, max_size=12))
@settings(max_examples=30)
def test_every_picture_of_a_robot_is_valid_with_the_same_names(motion) -> None:
    picture, scene = RobotPicture(LOOK, trail=60.0), Scene()
    for k, (state, thrust) in enumerate(motion):
        picture.add(1_000_000_000 * k, state)
        array = picture.draw(Time(sec=k), state, thrusting(thrust))
        check_markers(array, 'arena', LIFETIMES)
        scene.apply(array)
        always = {(name, 0) for name in ('body', 'heading', 'separation', 'name')}
        assert always <= scene.names <= always | {('plume', 0), ('trail', 0)}
        assert (('plume', 0) in scene.names) == (thrust > 1.05e-3)


@given(states.filter(lambda drawn: drawn[1] > 0.01))
@settings(max_examples=50)
def test_the_plume_points_along_the_force_and_leaves_behind(moving) -> None:
    state, thrust = moving
    control = thrusting(thrust)
    plume = Scene(RobotPicture(LOOK, 60.0).draw(Time(), state, control))['plume']
    rates = FloatingRobot().derivative(state, control)
    force = rates[2:4] / np.linalg.norm(rates[2:4])
    direction = [math.cos(yaw(plume)), math.sin(yaw(plume))]
    np.testing.assert_allclose(direction, force, atol=1e-9)
    along = (in_arena(plume) - state[:2]) @ force
    assert along.max() == pytest.approx(-LOOK.radius)
    length = along.max() - along.min()
    share = min(thrust / 1.05, 1.0)
    assert length == pytest.approx(4 * LOOK.radius * share)
    across = (in_arena(plume) - state[:2]) @ [-force[1], force[0]]
    assert np.ptp(across) == pytest.approx((0.3 + 0.9 * share) * LOOK.radius)


def test_heading_and_body_are_those_of_the_state() -> None:
    scene = Scene(RobotPicture(LOOK, 60.0).draw(Time(), robot(1.0, 2.0, 0.7), thrusting(0.0)))
    assert yaw(scene['heading']) == pytest.approx(0.7)
    for name in ('body', 'heading', 'separation'):
        where = scene[name].pose.position
        assert (where.x, where.y) == (1.0, 2.0)
    assert scene['separation'].scale.x == 0.4
    assert scene['body'].scale.x == 0.3
    assert scene['name'].text == 'robot2'
    assert scene['body'].color.r == scene['separation'].color.r


def test_markers_drawn_seldom_stay_longer() -> None:
    picture = RobotPicture(LOOK, 60.0)
    for k in range(2):
        picture.add(1_000_000_000 * k, robot(0.1 * k, 0.0, 0.0))
    array = picture.draw(Time(), robot(0.1, 0.0, 0.0), thrusting(0.0), lifetime=3.0)
    check_markers(array, 'arena', {**dict.fromkeys(LIFETIMES, 3.0), 'trail': 12.0})


def test_the_trail_is_repeated_now_and_then() -> None:
    picture = RobotPicture(LOOK, 60.0)
    for k in range(20):
        picture.add(1_000_000_000 * k, robot(0.1 * k, 0.0, 0.0))
    arrays = [picture.draw(Time(), robot(1.9, 0.0, 0.0), thrusting(0.0)) for _ in range(11)]
    with_trail = [k for k, array in enumerate(arrays) if 'trail' in {m.ns for m in array.markers}]
    assert with_trail == [0, 5, 10]
    trail = Scene(arrays[0])['trail']
    np.testing.assert_allclose([p.x for p in trail.points], 0.1 * np.arange(20))
    picture.clear()
    after = picture.draw(Time(), robot(0.0, 0.0, 0.0), thrusting(0.0))
    assert 'trail' not in Scene(arrays[0], after).namespaces


# A formation.

ARENA = Arena(length=5.0, width=3.0, obstacles=[1.0, 2.0, 0.3, 4.0, 1.0, 0.2])
GOALS = {
    'alice': np.array([1.0, 1.0, 0.5]),
    'bob': np.array([2.0, 1.0, -2.0]),
    'carol': np.array([3.0, 1.0, 3.0]),
}
WAY = np.linspace([0.5, 0.5], [3.0, 1.0], 1000)


def test_set_up_and_plan() -> None:
    array = formation_markers(ARENA, GOALS, {'carol': WAY})
    check_markers(array, 'arena', 0.0)
    assert array.markers[0].action == Marker.DELETEALL
    scene = Scene(array)
    corners = {(p.x, p.y) for p in scene['arena'].points}
    assert corners == {(0.0, 0.0), (5.0, 0.0), (5.0, 3.0), (0.0, 3.0)}
    zone = scene['obstacles', 1]
    assert (zone.pose.position.x, zone.pose.position.y, zone.scale.x) == (4.0, 1.0, 0.4)
    goal = scene['goal', 1].pose
    assert (goal.position.x, goal.position.y) == (2.0, 1.0)
    assert 2 * math.atan2(goal.orientation.z, goal.orientation.w) == pytest.approx(-2.0)
    ring = scene['safety_circle', 1].points
    np.testing.assert_allclose([math.hypot(p.x - 2, p.y - 1) for p in ring], 0.2)
    path = scene['planned_path', 2].points
    assert len(path) == LONGEST_PATH
    assert (path[0].x, path[-1].x) == (0.5, 3.0)
    assert {number for name, number in scene.names if name == 'planned_path'} == {2}


def test_robots_and_zones_that_are_gone_disappear() -> None:
    paths = dict.fromkeys(GOALS, WAY)
    fewer = {name: GOALS[name] for name in ('alice', 'bob')}
    last = formation_markers(Arena(), fewer, {name: WAY for name in fewer})
    scene = Scene(formation_markers(ARENA, GOALS, paths), last)
    assert scene.names == Scene(last).names
    assert ('goal', 2) not in scene.names
    assert 'obstacles' not in scene.namespaces
    incomplete = Arena(obstacles=[1.0, 2.0, 0.3, 4.0])
    assert Scene(formation_markers(incomplete, {})).names == {('arena', 0), ('obstacles', 0)}
