# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Plans and states of floating robots as ROS messages, and back.

Poses and rates of plans are those of the frame `arena`; an odometry's twist is, as its definition
has it, that of the robot's own frame.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, Quaternion, Transform, Twist, Vector3
from nav_msgs.msg import Odometry, Path
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.messages import joint_indices, nanoseconds_of, to_duration, to_stamp
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.trajectory import Interpolation, NANOSECOND, Trajectory

Array = NDArray[np.float64]

ARENA_FRAME = 'arena'
ROBOT_JOINTS = ('thruster', 'reaction_wheel')
ROBOT_STATES = FloatingRobot.state_names
ROBOT_CONTROLS = FloatingRobot.control_names

_UNIT_TOLERANCE = 1e-3


def to_quaternion(yaw: float) -> Quaternion:
    """Return the rotation by `yaw` [rad] about the vertical."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def yaw_of(rotation: Quaternion) -> float:
    """Return the angle about the vertical [rad], in [-pi, pi].

    Raises
    ------
    InvalidProblem
        If the quaternion is not of unit length.
    """
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(length - 1.0) < _UNIT_TOLERANCE:
        raise InvalidProblem(
            f'the orientation ({x:g}, {y:g}, {z:g}, {w:g}) has length {length:g}: must be a unit '
            'quaternion'
        )
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def robot_trajectory_message(
    robot: str, trajectory: Trajectory, stamp: Time
) -> MultiDOFJointTrajectory:
    """Return the motion of a robot: pose, rates and accelerations in the frame `arena`.

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
    """Return what the actuators do: joints [thruster, reaction_wheel].

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


def robot_trajectory(
    motion: MultiDOFJointTrajectory,
    controls: JointTrajectory,
    robot: str | None = None,
    interpolation: Interpolation = 'linear',
) -> Trajectory:
    """Read a robot's plan from its two messages; yaw is unwrapped from the first sample on.

    Raises
    ------
    InvalidProblem
        For messages of different plans, another robot, another frame, lengths that do not match,
        values that are not finite, quaternions that are not of unit length, or times that do not
        increase strictly from 0 or later.
    """
    _check_pair(motion, controls, robot)
    times = _instants([point.time_from_start for point in motion.points])
    if not np.array_equal(times, _instants([point.time_from_start for point in controls.points])):
        raise InvalidProblem("the samples of 'trajectory' and 'controls' differ in their times")
    poses = np.array([_pose(point, k) for k, point in enumerate(motion.points)])
    poses[:, 4] = np.unwrap(poses[:, 4])
    index = joint_indices(controls.joint_names, ROBOT_JOINTS)
    actuators = np.array([_actuators(p, index, k) for k, p in enumerate(controls.points)])
    return Trajectory(
        times=times,
        states=np.concatenate([poses, actuators[:, :1]], axis=1),
        controls=actuators[:, 1:],
        state_names=ROBOT_STATES,
        control_names=ROBOT_CONTROLS,
        interpolation=interpolation,
        state_units=FloatingRobot.state_units,
        control_units=FloatingRobot.control_units,
    )


def _check_pair(
    motion: MultiDOFJointTrajectory, controls: JointTrajectory, robot: str | None
) -> None:
    if robot is not None and list(motion.joint_names) != [robot]:
        raise InvalidProblem(
            f"trajectory 'joint_names' = {list(motion.joint_names)} must be ['{robot}']"
        )
    if motion.header.frame_id not in ('', ARENA_FRAME):
        raise InvalidProblem(
            f"trajectory 'frame_id' = '{motion.header.frame_id}' must be '{ARENA_FRAME}'"
        )
    if motion.header.stamp != controls.header.stamp:
        raise InvalidProblem("'trajectory' and 'controls' start at different instants")
    if len(motion.points) < 2:
        raise InvalidProblem(
            f"trajectory 'points' has {len(motion.points)} points: at least two are needed"
        )
    if len(motion.points) != len(controls.points):
        raise InvalidProblem(
            f"'trajectory' has {len(motion.points)} points, 'controls' {len(controls.points)}"
        )


def _instants(durations: Sequence[object]) -> Array:
    nanoseconds = np.array([nanoseconds_of(duration) for duration in durations], dtype=float)
    if nanoseconds[0] < 0:
        raise InvalidProblem(
            f"trajectory 'time_from_start' of point 0 is {nanoseconds[0] * NANOSECOND:g} s: must "
            'be in [0, inf) s'
        )
    return np.asarray(nanoseconds * NANOSECOND)


def _pose(point: MultiDOFJointTrajectoryPoint, number: int) -> list[float]:
    if len(point.transforms) != 1 or len(point.velocities) != 1:
        raise InvalidProblem(
            f'trajectory point {number} has {len(point.transforms)} transforms and '
            f'{len(point.velocities)} velocities: must be one of each'
        )
    place, rates = point.transforms[0], point.velocities[0]
    return [
        place.translation.x,
        place.translation.y,
        rates.linear.x,
        rates.linear.y,
        yaw_of(place.rotation),
        rates.angular.z,
    ]


def _actuators(point: JointTrajectoryPoint, index: Sequence[int], number: int) -> list[float]:
    for quantity in ('positions', 'velocities', 'effort'):
        if len(getattr(point, quantity)) != len(ROBOT_JOINTS):
            raise InvalidProblem(
                f"controls '{quantity}' of point {number} has {len(getattr(point, quantity))} "
                f'values for {len(ROBOT_JOINTS)} joints'
            )
    thruster, wheel = index
    return [
        point.positions[thruster],
        point.effort[thruster],
        point.velocities[thruster],
        point.effort[wheel],
    ]


def odometry_state(message: Odometry) -> Array:
    """Return x, y, u, v, yaw, omega (6,) of an odometry, velocities turned into the arena's frame.

    Raises
    ------
    InvalidProblem
        If the frame is another, a value is not finite, or the quaternion not of unit length.
    """
    if message.header.frame_id not in ('', ARENA_FRAME):
        raise InvalidProblem(
            f"odometry 'frame_id' = '{message.header.frame_id}' must be '{ARENA_FRAME}'"
        )
    place, rates = message.pose.pose, message.twist.twist
    yaw = yaw_of(place.orientation)
    c, s = math.cos(yaw), math.sin(yaw)
    state = np.array(
        [
            place.position.x,
            place.position.y,
            c * rates.linear.x - s * rates.linear.y,
            s * rates.linear.x + c * rates.linear.y,
            yaw,
            rates.angular.z,
        ]
    )
    if not np.isfinite(state).all():
        raise InvalidProblem('the odometry holds a value that is not a finite number')
    return state


def thruster_angle(message: JointState) -> float:
    """Return alpha [rad], the position of the joint `thruster`.

    Raises
    ------
    InvalidProblem
        If the joint is missing, has no position, or one that is not finite.
    """
    (index,) = joint_indices(message.name, ROBOT_JOINTS[:1])
    if len(message.position) != len(message.name):
        raise InvalidProblem(
            f"'position' has {len(message.position)} values for {len(message.name)} named joints"
        )
    if not math.isfinite(message.position[index]):
        raise InvalidProblem(
            f'the position of joint thruster is {message.position[index]}, not a finite number'
        )
    return float(message.position[index])
