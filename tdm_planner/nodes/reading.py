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
Trajectories and states read from messages, whichever library's classes those are.

Nothing of ROS is needed here: the nodes read the messages of rclpy with these functions, a report
those of a recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.frames import ARENA_FRAME
from tdm_planner.parameters import LARGEST, shown
from tdm_planner.plant_kind import Joint, PlantKind, QUANTITIES
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.trajectory import Interpolation, NANOSECOND, Trajectory

Array = NDArray[np.float64]

PENDULUM_JOINTS = ('pendulum', 'disk')
PENDULUM_STATES = ('theta', 'psi', 'theta_dot', 'psi_dot')
PENDULUM_CONTROLS = ('torque',)

ROBOT_JOINTS = ('thruster', 'reaction_wheel')
ROBOT_STATES = FloatingRobot.state_names
ROBOT_CONTROLS = FloatingRobot.control_names

_SECOND = 1_000_000_000  # ns
_UNIT_TOLERANCE = 1e-3
_FIELDS = ('positions', 'velocities', 'effort')  # of a trajectory's points, as `QUANTITIES`


def nanoseconds_of(message: Any) -> int:
    """Instant or span of a Time or Duration message [ns], without loss."""
    return int(message.sec) * _SECOND + int(message.nanosec)


def seconds_of(message: Any) -> float:
    """Instant or span of a Time or Duration message [s]; an instant loses 0.2 us in a float."""
    return nanoseconds_of(message) * NANOSECOND


def pendulum_trajectory(message: Any, interpolation: Interpolation | None = None) -> Trajectory:
    """
    Read a pendulum's plan from a message; joints may come in any order.

    A JointTrajectory does not say how efforts run between its points. Unless `interpolation` says
    so, efforts that stay equal over most intervals are held (switched torque), others are read as
    linear between the points.

    Raises
    ------
    InvalidProblem
        For joints that are missing, lengths that do not match, values that are not finite, or
        times that do not increase strictly from 0 or later.

    """
    index = joint_indices(message.joint_names, PENDULUM_JOINTS)
    if len(message.points) < 2:
        raise InvalidProblem(
            f"trajectory 'points' has {len(message.points)} points: at least two are needed"
        )
    columns = {
        quantity: _quantity(message, quantity, index)
        for quantity in ('positions', 'velocities', 'effort')
    }
    nanoseconds = [nanoseconds_of(point.time_from_start) for point in message.points]
    if nanoseconds[0] < 0:
        raise InvalidProblem(
            f"trajectory 'time_from_start' of point 0 is {nanoseconds[0] * NANOSECOND:g} s: must "
            'be in [0, inf) s'
        )
    torque = columns['effort'][:, 1:]
    if interpolation is None:
        held = np.count_nonzero(np.diff(torque[:-1, 0])) <= (len(torque) - 2) / 2
        interpolation = 'zero_order_hold' if held else 'linear'
    return Trajectory(
        times=np.array(nanoseconds, dtype=float) * NANOSECOND,
        states=np.concatenate([columns['positions'], columns['velocities']], axis=1),
        controls=torque,
        state_names=PENDULUM_STATES,
        control_names=PENDULUM_CONTROLS,
        interpolation=interpolation,
        state_units=('rad', 'rad', 'rad/s', 'rad/s'),
        control_units=('N m',),
    )


def _quantity(message: Any, quantity: str, index: Sequence[int]) -> Array:
    expected = len(message.joint_names)
    rows = [getattr(point, quantity) for point in message.points]
    for number, row in enumerate(rows):
        if len(row) != expected:
            raise InvalidProblem(
                f"trajectory '{quantity}' of point {number} has {len(row)} values for "
                f'{expected} joints'
            )
    return np.array(rows, dtype=float)[:, index]


def joint_indices(names: Sequence[str], wanted: Sequence[str]) -> list[int]:
    """
    Return where the `wanted` joints stand among `names`.

    Raises
    ------
    InvalidProblem
        Naming the joints that are missing, or there twice.

    """
    listed = list(names)
    wrong = [name for name in wanted if listed.count(name) != 1]
    if wrong:
        found = shown(', '.join(listed)) or 'none'
        raise InvalidProblem(
            f'joint(s) {", ".join(wrong)} must be named once, but the names are: {found}'
        )
    return [listed.index(name) for name in wanted]


def joint_motion(message: Any, joints: Sequence[str]) -> Array:
    """
    Return positions and velocities of `joints` in a JointState, (2 n,): x1.., x1'...

    Raises
    ------
    InvalidProblem
        For joints that are missing, lengths that do not match, or values that are not finite.

    """
    index = joint_indices(message.name, joints)
    values: list[float] = []
    for quantity in ('position', 'velocity'):
        row = getattr(message, quantity)
        if len(row) != len(message.name):
            raise InvalidProblem(
                f"'{quantity}' has {len(row)} values for {len(message.name)} named joints"
            )
        for joint, i in zip(joints, index, strict=True):
            if not abs(row[i]) <= LARGEST:
                raise InvalidProblem(
                    f'the {quantity} of joint {joint} is {row[i]}, not a finite number of at most '
                    f'{LARGEST:g}'
                )
            values.append(float(row[i]))
    return np.array(values)


def yaw_of(rotation: Any) -> float:
    """
    Return the angle about the vertical [rad], in [-pi, pi].

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


def robot_motion(motion: Any) -> Trajectory:
    """
    Read the motion of a robot alone, without its thruster and controls; yaw is unwrapped.

    The states are x, y, u, v, yaw, omega; there are no controls.

    Raises
    ------
    InvalidProblem
        As `robot_trajectory` does.

    """
    _check_motion(motion, None)
    return Trajectory(
        times=_instants([point.time_from_start for point in motion.points]),
        states=_poses(motion),
        controls=np.zeros((len(motion.points), 0)),
        state_names=ROBOT_STATES[:6],
        control_names=(),
        interpolation='linear',
        state_units=FloatingRobot.state_units[:6],
    )


def robot_trajectory(
    motion: Any,
    controls: Any,
    robot: str | None = None,
    interpolation: Interpolation | None = None,
) -> Trajectory:
    """
    Read a robot's plan from its two messages; yaw is unwrapped from the first sample on.

    Unless `interpolation` says how controls run between samples, thrust and torque that stay equal
    over most intervals are held, others run linearly.

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
    poses = _poses(motion)
    index = joint_indices(controls.joint_names, ROBOT_JOINTS)
    actuators = np.array([_actuators(p, index, k) for k, p in enumerate(controls.points)])
    if interpolation is None:
        changes = np.count_nonzero(np.diff(actuators[:-1, [1, 3]], axis=0), axis=0)
        held = (changes <= (times.size - 2) / 2).all()
        interpolation = 'zero_order_hold' if held else 'linear'
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


def _check_pair(motion: Any, controls: Any, robot: str | None) -> None:
    _check_motion(motion, robot)
    if motion.header.stamp != controls.header.stamp:
        raise InvalidProblem("'trajectory' and 'controls' start at different instants")
    if len(motion.points) != len(controls.points):
        raise InvalidProblem(
            f"'trajectory' has {len(motion.points)} points, 'controls' {len(controls.points)}"
        )


def _check_motion(motion: Any, robot: str | None) -> None:
    if robot is not None and list(motion.joint_names) != [robot]:
        raise InvalidProblem(
            f"trajectory 'joint_names' = {shown(list(motion.joint_names))} must be ['{robot}']"
        )
    if motion.header.frame_id not in ('', ARENA_FRAME):
        raise InvalidProblem(
            f"trajectory 'frame_id' = '{shown(motion.header.frame_id)}' must be '{ARENA_FRAME}'"
        )
    if len(motion.points) < 2:
        raise InvalidProblem(
            f"trajectory 'points' has {len(motion.points)} points: at least two are needed"
        )


def _poses(motion: Any) -> Array:
    """Return x, y, u, v, yaw, omega of every point, (n, 6)."""
    poses = np.array([_pose(point, k) for k, point in enumerate(motion.points)])
    poses[:, 4] = np.unwrap(poses[:, 4])
    return poses


def _instants(durations: Sequence[object]) -> Array:
    nanoseconds = np.array([nanoseconds_of(duration) for duration in durations], dtype=float)
    if nanoseconds[0] < 0:
        raise InvalidProblem(
            f"trajectory 'time_from_start' of point 0 is {nanoseconds[0] * NANOSECOND:g} s: must "
            'be in [0, inf) s'
        )
    return np.asarray(nanoseconds * NANOSECOND)


def _pose(point: Any, number: int) -> list[float]:
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


def _actuators(point: Any, index: Sequence[int], number: int) -> list[float]:
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


def odometry_state(message: Any) -> Array:
    """
    Return x, y, u, v, yaw, omega (6,) of an odometry, velocities turned into the arena's frame.

    Raises
    ------
    InvalidProblem
        If the frame is another, a value is not finite, or the quaternion not of unit length.

    """
    if message.header.frame_id not in ('', ARENA_FRAME):
        raise InvalidProblem(
            f"odometry 'frame_id' = '{shown(message.header.frame_id)}' must be '{ARENA_FRAME}'"
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
    if not (np.abs(state) <= LARGEST).all():
        raise InvalidProblem(
            f'the odometry holds a value that is not a finite number of at most {LARGEST:g}'
        )
    return state


def thruster_angle(message: Any) -> float:
    """
    Return alpha [rad], the position of the joint `thruster`.

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
    if not abs(message.position[index]) <= LARGEST:
        raise InvalidProblem(
            f'the position of joint thruster is {message.position[index]}, not a finite number of '
            f'at most {LARGEST:g}'
        )
    return float(message.position[index])


def read_plan(
    kind: PlantKind, message: Any, interpolation: Interpolation | None = None
) -> Trajectory:
    """
    Read a plan from a JointTrajectory; joints may come in any order.

    A message does not say how controls run between its points. Unless `interpolation` or the
    plant's kind says so, efforts that stay equal over most intervals are held (switched controls),
    others are read as linear between the points.

    Raises
    ------
    InvalidProblem
        For another frame, joints that are missing, lengths that do not match, values that are not
        finite, or times that do not increase strictly from 0 or later.

    """
    _check_frame(kind, message, 'trajectory')
    names, points = message.joint_names, message.points
    index = joint_indices(names, [joint.name for joint in kind.joints])
    if len(points) < 2:
        raise InvalidProblem(
            f"trajectory 'points' has {len(points)} points: at least two are needed"
        )
    known = {*kind.state_names, *kind.control_names}
    columns: dict[str, Array] = {}
    for quantity, field in zip(QUANTITIES, _FIELDS, strict=True):
        wanted = _wanted(kind.joints, quantity, known)
        if not wanted:
            continue
        rows = [getattr(point, field) for point in points]
        for number, row in enumerate(rows):
            if len(row) != len(names):
                raise InvalidProblem(
                    f"trajectory '{field}' of point {number} has {len(row)} values for "
                    f'{len(names)} joints'
                )
        values = np.array(rows, dtype=float)
        columns |= {name: values[:, index[place]] for place, name in wanted}
    efforts = [joint.effort for joint in kind.joints if joint.effort in known]
    return Trajectory(
        times=_points_instants(points),
        states=_stacked(columns, kind.state_names, len(points)),
        controls=_stacked(columns, kind.control_names, len(points)),
        state_names=kind.state_names,
        control_names=kind.control_names,
        interpolation=interpolation
        or kind.interpolation
        or _looks_like(_stacked(columns, efforts, len(points))),
        state_units=kind.state_units,
        control_units=kind.control_units,
    )


def _stacked(columns: Mapping[str, Array], names: Iterable[str], count: int) -> Array:
    return np.stack([np.zeros(count), *(columns[name] for name in names)], axis=1)[:, 1:]


def _looks_like(efforts: Array) -> Interpolation:
    changes = np.count_nonzero(np.diff(efforts[:-1], axis=0), axis=0)
    return 'zero_order_hold' if (changes <= (len(efforts) - 2) / 2).all() else 'linear'


def _points_instants(points: Sequence[Any]) -> Array:
    nanoseconds = np.array([nanoseconds_of(p.time_from_start) for p in points], dtype=float)
    if nanoseconds[0] < 0:
        raise InvalidProblem(
            f"trajectory 'time_from_start' of point 0 is {nanoseconds[0] * NANOSECOND:g} s: must "
            'be in [0, inf) s'
        )
    return np.asarray(nanoseconds * NANOSECOND)


def _wanted(joints: Sequence[Joint], quantity: str, known: set[str]) -> list[tuple[int, str]]:
    """Return the known names that a quantity of the joints has, by the joint's place."""
    found = [(place, str(getattr(joint, quantity))) for place, joint in enumerate(joints)]
    return [(place, name) for place, name in found if name in known]


def _check_frame(kind: PlantKind, message: Any, what: str) -> None:
    if kind.odometry and message.header.frame_id not in ('', kind.frame):
        raise InvalidProblem(
            f"{what} 'frame_id' = '{shown(message.header.frame_id)}' must be '{kind.frame}'"
        )
