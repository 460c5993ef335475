# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Plans of floating robots as ROS messages; `reading` reads them, and states, back.

Poses and rates of plans are those of the frame `arena`; an odometry's twist is, as its definition
has it, that of the robot's own frame.
"""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, Quaternion, Transform, Twist, Vector3
from nav_msgs.msg import Path
import numpy as np
from numpy.typing import NDArray
from tdm_planner.nodes.frames import ARENA_FRAME
from tdm_planner.nodes.messages import to_duration, to_stamp
from tdm_planner.nodes.reading import (
    odometry_state,
    ROBOT_CONTROLS,
    ROBOT_JOINTS,
    ROBOT_STATES,
    robot_trajectory,
    thruster_angle,
    yaw_of,
)
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.trajectory import NANOSECOND, Trajectory
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)

__all__ = [
    'ARENA_FRAME',
    'ROBOT_CONTROLS',
    'ROBOT_JOINTS',
    'ROBOT_STATES',
    'odometry_state',
    'robot_controls_message',
    'robot_path_message',
    'robot_trajectory',
    'robot_trajectory_message',
    'thruster_angle',
    'to_quaternion',
    'yaw_of',
]

Array = NDArray[np.float64]


def to_quaternion(yaw: float) -> Quaternion:
    """Return the rotation by `yaw` [rad] about the vertical."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def robot_trajectory_message(
    robot: str, trajectory: Trajectory, stamp: Time
) -> MultiDOFJointTrajectory:
    """
    Return the motion of a robot: pose, rates and accelerations in the frame `arena`.

    `stamp` is the instant at which the motion starts.
    """
    assert trajectory.rates is not None
    rates = np.concatenate([trajectory.rates[:, 0], trajectory.rates[-1:, 1]])
    message = MultiDOFJointTrajectory(joint_names=[robot])
    message.header.stamp, message.header.frame_id = stamp, ARENA_FRAME
    for t, (x, y, u, v, yaw, omega, _), rate in zip(
        trajectory.times.tolist(), trajectory.states.tolist(), rates.tolist(), strict=True
    ):
        pose = Transform(translation=Vector3(x=x, y=y), rotation=to_quaternion(yaw))
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[pose],
                velocities=[_twist(u, v, omega)],
                accelerations=[_twist(rate[2], rate[3], rate[5])],
                time_from_start=to_duration(t),
            )
        )
    return message


def robot_controls_message(
    trajectory: Trajectory, plant: FloatingRobot, stamp: Time
) -> JointTrajectory:
    """
    Return what the actuators do: joints [thruster, reaction_wheel].

    Positions [alpha, 0], velocities [thruster rate, change of the wheel's speed since the start],
    efforts [thrust, torque].
    """
    wheel = plant.wheel_speed(
        trajectory.state('omega'), initial_omega=float(trajectory.state('omega')[0])
    )
    message = JointTrajectory(joint_names=ROBOT_JOINTS)
    message.header.stamp, message.header.frame_id = stamp, ARENA_FRAME
    columns = (
        trajectory.times,
        trajectory.state('alpha'),
        trajectory.control('thruster_rate'),
        wheel,
        trajectory.control('thrust'),
        trajectory.control('torque'),
    )
    message.points = [
        JointTrajectoryPoint(
            positions=[alpha, 0.0],
            velocities=[rate, speed],
            effort=[thrust, torque],
            time_from_start=to_duration(t),
        )
        for t, alpha, rate, speed, thrust, torque in zip(
            *(column.tolist() for column in columns), strict=True
        )
    ]
    return message


def robot_path_message(trajectory: Trajectory, start: int) -> Path:
    """Return the path; every pose is stamped with its instant, `start` [ns] that of the first."""
    path = Path()
    path.header.stamp, path.header.frame_id = to_stamp(start), ARENA_FRAME
    for t, (x, y, _, _, yaw, _, _) in zip(
        trajectory.times.tolist(), trajectory.states.tolist(), strict=True
    ):
        pose = PoseStamped()
        pose.header.stamp = to_stamp(start + round(t / NANOSECOND))
        pose.header.frame_id = ARENA_FRAME
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation = to_quaternion(yaw)
        path.poses.append(pose)
    return path


def _twist(x: float, y: float, turn: float) -> Twist:
    return Twist(linear=Vector3(x=x, y=y), angular=Vector3(z=turn))
