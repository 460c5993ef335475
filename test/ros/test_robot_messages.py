# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

import math

from geometry_msgs.msg import Quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import nanoseconds_of, to_stamp
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
from tdm_planner.trajectory import to_nanoseconds, Trajectory

PLANT = FloatingRobot()
START = 1_700_000_000_123_456_789


def plan(yaws=(3.0, 3.3, 3.6)):
    times = to_nanoseconds([0.0, 0.4, 1.0])
    rng = np.random.default_rng(1)
    states = rng.uniform(-1, 1, (3, 7))
    states[:, 4] = yaws
    return Trajectory(
        times,
        states,
        rng.uniform(0, 1, (3, 3)),
        PLANT.state_names,
        PLANT.control_names,
        'linear',
    ).with_rates(PLANT.derivative)


def messages(trajectory):
    return (
        robot_trajectory_message('robot1', trajectory, to_stamp(START)),
        robot_controls_message(trajectory, PLANT, to_stamp(START)),
    )


def test_a_plan_survives_the_messages():
    original = plan()
    again = robot_trajectory(*messages(original), 'robot1')
    np.testing.assert_array_equal(again.times, original.times)
    np.testing.assert_allclose(again.states, original.states, atol=1e-15)
    np.testing.assert_array_equal(again.controls, original.controls)
    assert again.interpolation == 'linear'


def test_yaw_is_unwrapped_over_turns():
    again = robot_trajectory(*messages(plan((3.0, 5.5, 8.0))))
    np.testing.assert_allclose(again.states[:, 4], [3.0, 5.5, 8.0], atol=1e-14)


def test_frames_stamps_and_wheel_speed():
    motion, controls = messages(plan())
    path = robot_path_message(plan(), START)
    assert motion.header.frame_id == path.header.frame_id == 'arena'
    stamps = [nanoseconds_of(p.header.stamp) - START for p in path.poses]
    assert stamps == [0, 400_000_000, 1_000_000_000]
    assert list(controls.joint_names) == ['thruster', 'reaction_wheel']
    speeds = np.array([p.velocities[1] for p in controls.points])
    momentum = PLANT.angular_momentum(plan().state('omega'), speeds)
    np.testing.assert_allclose(momentum, momentum[0], atol=1e-12)
    acceleration = motion.points[0].accelerations[0].linear
    np.testing.assert_allclose([acceleration.x, acceleration.y], plan().rates[0, 0, 2:4])


def spoil_joint(m, c):
    m.joint_names = ['robot2']


def spoil_frame(m, c):
    m.header.frame_id = 'map'


def spoil_stamp(m, c):
    c.header.stamp.sec += 1


def spoil_length(m, c):
    c.points = c.points[:-1]


def spoil_points(m, c):
    m.points, c.points = m.points[:1], c.points[:1]


def spoil_time(m, c):
    c.points[1].time_from_start.nanosec += 1


def spoil_order(m, c):
    for message in (m, c):
        message.points = [message.points[i] for i in (0, 2, 1)]


def spoil_quaternion(m, c):
    m.points[1].transforms[0].rotation = Quaternion(w=2.0)


def spoil_value(m, c):
    m.points[1].transforms[0].translation.x = math.nan


def spoil_effort(m, c):
    c.points[1].effort = [1.0]


def spoil_transforms(m, c):
    m.points[1].transforms = []


@pytest.mark.parametrize(
    ('spoil', 'words'),
    [
        (spoil_joint, "must be ['robot1']"),
        (spoil_frame, "'map' must be 'arena'"),
        (spoil_stamp, 'different instants'),
        (spoil_length, '3 points'),
        (spoil_points, 'at least two'),
        (spoil_time, 'differ in their times'),
        (spoil_order, 'increase strictly'),
        (spoil_quaternion, 'unit quaternion'),
        (spoil_value, 'not finite'),
        (spoil_effort, "'effort' of point 1 has 1"),
        (spoil_transforms, '0 transforms'),
    ],
)
def test_malformed_plans_are_refused(spoil, words):
    pair = messages(plan())
    spoil(*pair)
    with pytest.raises(InvalidProblem) as refused:
        robot_trajectory(*pair, 'robot1')
    assert words in str(refused.value)


@given(st.floats(-math.pi, math.pi))
@settings(deadline=None, derandomize=True)
def test_yaw_of_quaternions(yaw):
    turned = yaw_of(to_quaternion(yaw))
    assert math.remainder(turned - yaw, 2 * math.pi) == pytest.approx(0, abs=1e-12)


def odometry(**pose):
    message = Odometry()
    message.header.frame_id = 'arena'
    message.pose.pose.position.x, message.pose.pose.position.y = 1.0, 2.0
    message.pose.pose.orientation = to_quaternion(math.pi / 2)
    message.twist.twist.linear.x = 0.3  # forward, which is along y here
    message.twist.twist.angular.z = 0.1
    return message


def test_odometry_twist_is_turned_into_the_arena():
    state = odometry_state(odometry())
    np.testing.assert_allclose(state, [1, 2, 0, 0.3, math.pi / 2, 0.1], atol=1e-15)


def test_bad_states_are_refused():
    message = odometry()
    message.pose.pose.position.x = math.inf
    with pytest.raises(InvalidProblem, match='finite'):
        odometry_state(message)
    message = odometry()
    message.pose.pose.orientation = Quaternion(w=0.0)
    with pytest.raises(InvalidProblem, match='unit quaternion'):
        odometry_state(message)
    message = odometry()
    message.header.frame_id = 'odom'
    with pytest.raises(InvalidProblem, match="'odom' must be 'arena'"):
        odometry_state(message)
    assert thruster_angle(JointState(name=['thruster'], position=[0.5])) == 0.5
    for bad in (
        JointState(),
        JointState(name=['thruster']),
        JointState(name=['thruster'], position=[math.nan]),
    ):
        with pytest.raises(InvalidProblem):
            thruster_angle(bad)
