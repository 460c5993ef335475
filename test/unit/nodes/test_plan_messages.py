# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Plans, states and instants as messages and back: of the pendulum, and of a robot."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

from geometry_msgs.msg import Quaternion
from hypothesis import given, settings, strategies
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import (
    joint_motion,
    nanoseconds_of,
    pendulum_message,
    pendulum_trajectory,
    seconds_of,
    to_duration,
    to_stamp,
)
from tdm_planner.nodes.robot_messages import (
    odometry_state,
    robot_controls_message,
    robot_path_message,
    robot_trajectory,
    robot_trajectory_message,
    thruster_angle,
    to_quaternion,
    yaw_of,
)
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.trajectory import to_nanoseconds, Trajectory
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

ROBOT = FloatingRobot()
START = 1_700_000_000_123_456_789
STAMP = to_stamp(START)


def switched(count: int = 20) -> Trajectory:
    """Consistent enough to be a message: torque jumps in the middle, states are arbitrary."""
    rng = np.random.default_rng(1)
    times = to_nanoseconds(np.concatenate([[0.0], np.cumsum(rng.uniform(1e-3, 5e-3, count - 1))]))
    torque = np.where(np.arange(count) < count // 2, 0.02, -0.02)[:, None]
    return Trajectory(
        times=times,
        states=rng.normal(size=(count, 4)),
        controls=torque,
        state_names=('theta', 'psi', 'theta_dot', 'psi_dot'),
        control_names=('torque',),
    ).with_rates(RotaryPendulum().derivative)


@pytest.fixture
def made() -> JointTrajectory:
    return pendulum_message(switched(), STAMP)


def test_a_trajectory_comes_back_from_the_wire_to_the_last_bit(made: JointTrajectory) -> None:
    """But for the last torque, which is held for no time; accelerations are those after a jump."""
    plan, middle = switched(), switched().times.size // 2
    read = pendulum_trajectory(deserialize_message(serialize_message(made), JointTrajectory))
    assert np.array_equal(read.times, plan.times)
    assert np.array_equal(read.states, plan.states)
    assert np.array_equal(read.controls[:-1], plan.controls[:-1])
    assert read.controls[-1, 0] == 0.0
    assert read.interpolation == 'zero_order_hold'
    assert read.state_names == plan.state_names
    assert made.header.stamp == STAMP
    expected = RotaryPendulum().derivative(plan.states, plan.controls)[:, 2:]
    assert np.array_equal([point.accelerations for point in made.points], expected)
    assert made.points[middle - 1].effort[1] != made.points[middle].effort[1]
    bare = Trajectory(plan.times, plan.states, plan.controls, plan.state_names, plan.control_names)
    with pytest.raises(InvalidProblem, match='needs the states theta, psi'):
        pendulum_message(bare, STAMP)


def test_torque_that_varies_everywhere_is_read_as_a_spline(made: JointTrajectory) -> None:
    for number, point in enumerate(made.points):
        point.effort = [0.0, math.sin(number)]
    assert pendulum_trajectory(made).interpolation == 'linear'
    assert pendulum_trajectory(made, 'linear').interpolation == 'linear'
    made.joint_names = ['disk', 'pendulum']  # joints may come in another order
    for point in made.points:
        for quantity in ('positions', 'velocities', 'effort'):
            setattr(point, quantity, list(getattr(point, quantity))[::-1])
    assert np.array_equal(pendulum_trajectory(made).states, switched().states)


@pytest.mark.parametrize(
    ('spoil', 'says'),
    [
        (lambda m: setattr(m, 'joint_names', ['pendulum', 'a']), 'joint(s) disk must be named'),
        (lambda m: setattr(m, 'joint_names', []), 'names are: none'),
        (lambda m: setattr(m, 'points', []), 'has 0 points'),
        (
            lambda m: setattr(m.points[3], 'velocities', [0.0]),
            "'velocities' of point 3 has 1 values for 2 joints",
        ),
        (lambda m: setattr(m.points[0], 'effort', []), "'effort' of point 0 has 0 values"),
        (
            lambda m: setattr(m.points[5], 'time_from_start', m.points[4].time_from_start),
            "'times' must increase strictly",
        ),
        (
            lambda m: setattr(m.points[0], 'time_from_start', to_duration(-1.0)),
            "'time_from_start' of point 0 is -1 s",
        ),
        (
            lambda m: setattr(m.points[2], 'positions', [math.nan, 0.0]),
            "'states' holds a value that is not finite",
        ),
    ],
)
def test_malformed_trajectories_are_refused(
    made: JointTrajectory, spoil: Callable[[Any], None], says: str
) -> None:
    spoil(made)
    with pytest.raises(InvalidProblem) as refused:
        pendulum_trajectory(made)
    assert says in str(refused.value)


@settings(max_examples=50)
@given(
    strategies.integers(-(2**31) * 10**9, (2**31 - 1) * 10**9),
    strategies.floats(-1e5, 1e5),
    strategies.floats(-math.pi, math.pi),
)
def test_instants_durations_and_yaw_keep_their_values(
    nanoseconds: int, seconds: float, yaw: float
) -> None:
    assert nanoseconds_of(to_stamp(nanoseconds)) == nanoseconds
    assert abs(seconds_of(to_duration(seconds)) - seconds) <= 0.5e-9 + 1e-15 * abs(seconds)
    turned = yaw_of(to_quaternion(yaw))
    assert math.remainder(turned - yaw, 2 * math.pi) == pytest.approx(0, abs=1e-12)


def test_the_motion_of_joints_is_picked_by_name() -> None:
    state = JointState(
        name=['wheel', 'disk', 'pendulum'], position=[1.0, 2.0, 3.0], velocity=[4.0, 5.0, 6.0]
    )
    assert joint_motion(state, ('pendulum', 'disk')).tolist() == [3.0, 2.0, 6.0, 5.0]


@pytest.mark.parametrize(
    ('state', 'says'),
    [
        (JointState(name=['disk']), 'joint(s) pendulum must be named once'),
        (JointState(name=['disk', 'pendulum', 'disk']), 'joint(s) disk must be named once'),
        (JointState(name=['disk', 'pendulum']), "'position' has 0 values for 2 named joints"),
        (
            JointState(name=['disk', 'pendulum'], position=[0.0, 0.0], velocity=[math.inf, 0.0]),
            'the velocity of joint disk is inf, not a finite number',
        ),
    ],
)
def test_states_without_the_joints_are_refused(state: JointState, says: str) -> None:
    with pytest.raises(InvalidProblem) as error:
        joint_motion(state, ('pendulum', 'disk'))
    assert says in str(error.value)


# A robot.


def plan(yaws: tuple[float, float, float] = (3.0, 3.3, 3.6)) -> Trajectory:
    rng = np.random.default_rng(1)
    states = rng.uniform(-1, 1, (3, 7))
    states[:, 4] = yaws
    controls = rng.uniform(0, 1, (3, 3))
    times = to_nanoseconds([0.0, 0.4, 1.0])
    names = ROBOT.state_names, ROBOT.control_names
    return Trajectory(times, states, controls, *names, 'linear').with_rates(ROBOT.derivative)


def messages(trajectory: Trajectory) -> tuple[MultiDOFJointTrajectory, JointTrajectory]:
    return (
        robot_trajectory_message('robot1', trajectory, STAMP),
        robot_controls_message(trajectory, ROBOT, STAMP),
    )


def test_a_robots_plan_survives_the_messages() -> None:
    original = plan()
    again = robot_trajectory(*messages(original), 'robot1')
    np.testing.assert_array_equal(again.times, original.times)
    np.testing.assert_allclose(again.states, original.states, atol=1e-15)
    np.testing.assert_array_equal(again.controls, original.controls)
    assert again.interpolation == 'linear'
    turns = robot_trajectory(*messages(plan((3.0, 5.5, 8.0))))
    np.testing.assert_allclose(turns.states[:, 4], [3.0, 5.5, 8.0], atol=1e-14)


def test_frames_stamps_and_wheel_speed() -> None:
    motion, controls = messages(plan())
    path = robot_path_message(plan(), START)
    assert motion.header.frame_id == path.header.frame_id == 'arena'
    stamps = [nanoseconds_of(p.header.stamp) - START for p in path.poses]
    assert stamps == [0, 400_000_000, 1_000_000_000]
    assert list(controls.joint_names) == ['thruster', 'reaction_wheel']
    speeds = np.array([p.velocities[1] for p in controls.points])
    momentum = ROBOT.angular_momentum(plan().state('omega'), speeds)
    np.testing.assert_allclose(momentum, momentum[0], atol=1e-12)
    acceleration = motion.points[0].accelerations[0].linear
    np.testing.assert_allclose([acceleration.x, acceleration.y], plan().rates[0, 0, 2:4])


def turn_back(m: Any, c: Any) -> None:
    for made in (m, c):
        made.points = [made.points[i] for i in (0, 2, 1)]


def shorten(m: Any, c: Any) -> None:
    m.points, c.points = m.points[:1], c.points[:1]


def delay(m: Any, c: Any) -> None:
    c.points[1].time_from_start.nanosec += 1


@pytest.mark.parametrize(
    ('spoil', 'words'),
    [
        (lambda m, c: setattr(m, 'joint_names', ['robot2']), "must be ['robot1']"),
        (lambda m, c: setattr(m.header, 'frame_id', 'map'), "'map' must be 'arena'"),
        (lambda m, c: setattr(c.header, 'stamp', to_stamp(START + 1)), 'different instants'),
        (lambda m, c: c.points.pop(), '3 points'),
        (shorten, 'at least two'),
        (delay, 'differ in their times'),
        (turn_back, 'increase strictly'),
        (
            lambda m, c: setattr(m.points[1].transforms[0], 'rotation', Quaternion(w=2.0)),
            'unit quaternion',
        ),
        (
            lambda m, c: setattr(m.points[1].transforms[0].translation, 'x', math.nan),
            'not finite',
        ),
        (lambda m, c: setattr(c.points[1], 'effort', [1.0]), "'effort' of point 1 has 1"),
        (lambda m, c: setattr(m.points[1], 'transforms', []), '0 transforms'),
    ],
)
def test_malformed_plans_of_robots_are_refused(spoil: Callable[..., None], words: str) -> None:
    pair = messages(plan())
    spoil(*pair)
    with pytest.raises(InvalidProblem) as refused:
        robot_trajectory(*pair, 'robot1')
    assert words in str(refused.value)


def odometry() -> Odometry:
    message = Odometry()
    message.header.frame_id = 'arena'
    message.pose.pose.position.x, message.pose.pose.position.y = 1.0, 2.0
    message.pose.pose.orientation = to_quaternion(math.pi / 2)
    message.twist.twist.linear.x = 0.3  # forward, which is along y here
    message.twist.twist.angular.z = 0.1
    return message


def test_the_twist_is_turned_into_the_arena() -> None:
    state = odometry_state(odometry())
    np.testing.assert_allclose(state, [1, 2, 0, 0.3, math.pi / 2, 0.1], atol=1e-15)


@pytest.mark.parametrize(
    ('spoil', 'words'),
    [
        (lambda o: setattr(o.pose.pose.position, 'x', math.inf), 'finite'),
        (lambda o: setattr(o.pose.pose, 'orientation', Quaternion(w=0.0)), 'unit quaternion'),
        (lambda o: setattr(o.header, 'frame_id', 'odom'), "'odom' must be 'arena'"),
    ],
)
def test_bad_odometry_is_refused(spoil: Callable[[Any], None], words: str) -> None:
    message = odometry()
    spoil(message)
    with pytest.raises(InvalidProblem, match=words):
        odometry_state(message)


def test_the_angle_of_the_thruster() -> None:
    assert thruster_angle(JointState(name=['thruster'], position=[0.5])) == 0.5
    for bad in (
        JointState(),
        JointState(name=['thruster']),
        JointState(name=['thruster'], position=[math.nan]),
    ):
        with pytest.raises(InvalidProblem):
            thruster_angle(bad)
