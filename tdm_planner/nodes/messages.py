# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Plans, states and commands as ROS messages, exact to the nanosecond; `reading` reads them back.

Every plant's messages are filled by its table of joints: a quantity that is no state or control of
the plant is 0. With them comes the quality of service that both sides must agree on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped, Quaternion
from nav_msgs.msg import Odometry, Path
import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.plant_kind import Joint, PlantKind
from tdm_planner.trajectory import NANOSECOND, SECOND, Trajectory
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# A late subscriber gets the active plan or status.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

# States and commands: only the newest counts. A reliable subscriber would hold messages back until
# a lost one is sent again: over a link of 20 ms, for another 15 to 150 ms. Best effort matches
# publishers of either kind.
NEWEST = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)

QUEUE = 10  # messages, sent again where they get lost

# Requests and answers of a service that many may call at once. Of the usual ten, the oldest would
# be overwritten while the node is busy, and whoever sent it would wait for ever.
SERVICE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)

# Rates below it, and below that share of the largest, are rest: what a plan may be off by at its
# end. Trajectory controllers want the last velocities to be exactly zero
# (`allow_nonzero_velocity_at_trajectory_end`).
_AT_REST = 1e-3


def to_stamp(nanoseconds: int) -> Time:
    """Instant [ns since the epoch] as a message."""
    return Time(sec=nanoseconds // SECOND, nanosec=nanoseconds % SECOND)


def from_wire(data: bytes, kind: type) -> Any:
    """
    Return a message of the type `kind` from its serialised form.

    Raise InvalidProblem if it is no such message.
    """
    try:
        return deserialize_message(data, kind)
    except RuntimeError:  # RMWError
        raise InvalidProblem(f'cannot deserialise {len(data)} bytes as {kind.__name__}') from None


def to_duration(seconds: float) -> Duration:
    """Span of time [s], rounded to the nanosecond, as a message."""
    nanoseconds = round(seconds / NANOSECOND)
    return Duration(sec=nanoseconds // SECOND, nanosec=nanoseconds % SECOND)


def to_quaternion(yaw: float) -> Quaternion:
    """Return the rotation by `yaw` [rad] about the vertical."""
    return Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def plan_message(
    kind: PlantKind, trajectory: Trajectory, stamp: Time, extra: Mapping[str, Array] = {}
) -> JointTrajectory:
    """
    Return a plan as a message; `stamp` is the instant at which the motion starts.

    `extra` are histories (N,) by name that joints have beside states and controls. Where the
    trajectory has `rates`, accelerations are those after a jump of the controls, and a joint
    without a velocity has the rate of its position; accelerations are differences where velocities
    are no states. Without `rates` they are 0, not empty: rosbags, which reports read by, misreads
    points without accelerations. Velocities are exactly zero at the end of a motion that ends at
    rest. Controls that are held act for no time at the last point and are 0 there: a controller
    that keeps the last point must not keep them.
    """
    controls = trajectory.controls.copy()
    if trajectory.interpolation == 'zero_order_hold':
        controls[-1] = 0.0
    states, rated = trajectory.states.copy(), {joint.velocity for joint in kind.joints}
    velocities = [i for i, name in enumerate(trajectory.state_names) if name in rated]
    speeds = np.abs(states[:, velocities])
    if (speeds[-1] < min(_AT_REST, _AT_REST * speeds.max(initial=0.0))).all():
        states[-1, velocities] = 0.0
    columns = {
        **extra,
        **dict(zip(trajectory.state_names, states.T, strict=True)),
        **dict(zip(trajectory.control_names, controls.T, strict=True)),
    }
    steps, nothing = np.diff(trajectory.times), np.zeros(trajectory.times.size)
    rates, changes = dict[str, Array](), dict[str, Array]()  # of states; of their rates, between
    if trajectory.rates is not None:
        # Row k of `rates` belongs to the interval after sample k; the last sample ends the last.
        after = np.concatenate([trajectory.rates[:, 0], trajectory.rates[-1:, 1]])
        rates = dict(zip(trajectory.state_names, after.T, strict=True))
        between = np.diff(trajectory.rates, axis=1)[:, 0].T / steps
        changes = dict(zip(trajectory.state_names, between, strict=True))
    held = trajectory.control_names if trajectory.interpolation == 'zero_order_hold' else ()

    def acceleration(joint: Joint) -> Array:
        if joint.velocity in rates or joint.velocity in held:
            return rates.get(joint.velocity, nothing)
        if joint.velocity in columns:
            change = np.diff(columns[joint.velocity]) / steps
        else:
            change = changes.get(joint.position, nothing[1:])
        return np.append(change, change[-1])

    filled = [
        [columns.get(joint.position, nothing) for joint in kind.joints],
        [
            columns[j.velocity] if j.velocity in columns else rates.get(j.position, nothing)
            for j in kind.joints
        ],
        [acceleration(joint) if rates else nothing for joint in kind.joints],
        [columns.get(joint.effort, nothing) for joint in kind.joints],
    ]
    message = JointTrajectory(joint_names=[joint.name for joint in kind.joints])
    message.header.stamp, message.header.frame_id = stamp, kind.frame
    message.points = [
        JointTrajectoryPoint(
            positions=positions,
            velocities=velocities,
            accelerations=accelerations,
            effort=effort,
            time_from_start=to_duration(time),
        )
        for time, positions, velocities, accelerations, effort in zip(
            trajectory.times.tolist(), *(np.array(rows).T.tolist() for rows in filled), strict=True
        )
    ]
    return message


def joint_states(
    joints: Sequence[Joint], values: Mapping[str, float], rates: Mapping[str, float] = {}
) -> JointState:
    """
    Return joints with states and controls by name, without stamp; 0 what has no value.

    A joint without a velocity has the rate of its position, if `rates` has it.
    """
    return JointState(
        name=[joint.name for joint in joints],
        position=[values.get(joint.position, 0.0) for joint in joints],
        velocity=[values.get(j.velocity, rates.get(j.position, 0.0)) for j in joints],
        effort=[values.get(joint.effort, 0.0) for joint in joints],
    )


def command_message(kind: PlantKind, control: Array) -> JointState:
    """Return the controls (nu,) as a command without stamp: efforts, velocities if there are."""
    values = dict(zip(kind.control_names, control.tolist(), strict=True))
    message = joint_states(kind.actuated, values)
    message.position = []
    if not any(joint.velocity in values for joint in kind.actuated):
        message.velocity = []
    return message


def odometry(
    kind: PlantKind,
    values: Mapping[str, float],
    deviations: Mapping[str, float],
    stamp: Time,
    child: str,
) -> Odometry:
    """
    Return the states of the joints x, y and yaw by name, the twist turned into the child's frame.

    `deviations` are the standard deviations of the states, by name.
    """
    joints = {joint.name: joint for joint in kind.joints}
    moved = [joints[name] for name in kind.odometry]
    x, y, yaw = (values[joint.position] for joint in moved)
    u, v, omega = (values[joint.velocity] for joint in moved)
    message = Odometry(child_frame_id=child)
    message.header.stamp, message.header.frame_id = stamp, kind.frame
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation = to_quaternion(yaw)
    cosine, sine = math.cos(yaw), math.sin(yaw)
    message.twist.twist.linear.x = cosine * u + sine * v
    message.twist.twist.linear.y = cosine * v - sine * u
    message.twist.twist.angular.z = omega
    message.pose.covariance = _covariance([deviations[joint.position] for joint in moved])
    message.twist.covariance = _covariance([deviations[joint.velocity] for joint in moved])
    return message


def _covariance(deviations: Sequence[float]) -> Array:
    """Row-major covariance (36,) of x, y and the rotation about z, from standard deviations."""
    matrix = np.zeros((6, 6))
    matrix[[0, 1, 5], [0, 1, 5]] = np.square(deviations)
    return matrix.ravel()


def path_message(kind: PlantKind, trajectory: Trajectory, start: int) -> Path:
    """Return the path; every pose is stamped with its instant, `start` [ns] that of the first."""
    path = Path()
    path.header.stamp, path.header.frame_id = to_stamp(start), kind.frame
    poses = (trajectory.state(name).tolist() for name in ('x', 'y', 'yaw'))
    for t, x, y, yaw in zip(trajectory.times.tolist(), *poses, strict=True):
        pose = PoseStamped()
        pose.header.stamp = to_stamp(start + round(t / NANOSECOND))
        pose.header.frame_id = kind.frame
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation = to_quaternion(yaw)
        path.poses.append(pose)
    return path
