# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories and states as ROS messages, and back, exact to the nanosecond."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from builtin_interfaces.msg import Duration, Time
import numpy as np
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tdm_planner.exceptions import InvalidProblem
from tdm_planner.trajectory import Interpolation, NANOSECOND, Trajectory

Array = NDArray[np.float64]

# A late subscriber gets the plan in force.
LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

PENDULUM_JOINTS = ('pendulum', 'disk')
PENDULUM_STATES = ('theta', 'psi', 'theta_dot', 'psi_dot')
PENDULUM_CONTROLS = ('torque',)
WORLD_FRAME = 'world'

_SECOND = 1_000_000_000  # ns


def to_stamp(nanoseconds: int) -> Time:
    """Instant [ns since the epoch] as a message."""
    return Time(sec=nanoseconds // _SECOND, nanosec=nanoseconds % _SECOND)


def to_duration(seconds: float) -> Duration:
    """Span of time [s], rounded to the nanosecond, as a message."""
    nanoseconds = round(seconds / NANOSECOND)
    return Duration(sec=nanoseconds // _SECOND, nanosec=nanoseconds % _SECOND)


def nanoseconds_of(message: Any) -> int:
    """Instant or span of a Time or Duration message [ns], without loss."""
    return int(message.sec) * _SECOND + int(message.nanosec)


def seconds_of(message: Any) -> float:
    """Instant or span of a Time or Duration message [s]; an instant loses 0.2 us in a float."""
    return nanoseconds_of(message) * NANOSECOND


def pendulum_message(trajectory: Trajectory, stamp: Time) -> JointTrajectory:
    """Return the pendulum's plan as a message; `stamp` is the instant at which the motion starts.

    Joints [pendulum, disk]: positions [theta, psi], their rates, accelerations (where torque
    jumps, those after the jump) and effort [0, T].

    Raises
    ------
    InvalidProblem
        If the trajectory is not a pendulum's, or has no rates.
    """
    if trajectory.state_names != PENDULUM_STATES or trajectory.rates is None:
        raise InvalidProblem(
            f'a pendulum trajectory needs the states {", ".join(PENDULUM_STATES)} and their rates'
        )
    # Row k of `rates` belongs to the interval after sample k; the last sample ends the last one.
    rates = np.concatenate([trajectory.rates[:, 0], trajectory.rates[-1:, 1]])
    message = JointTrajectory(joint_names=PENDULUM_JOINTS)
    message.header.stamp = stamp
    message.header.frame_id = WORLD_FRAME
    message.points = [
        JointTrajectoryPoint(
            positions=state[:2].tolist(),
            velocities=state[2:].tolist(),
            accelerations=rate[2:].tolist(),
            effort=[0.0, torque],
            time_from_start=to_duration(time),
        )
        for time, state, rate, torque in zip(
            trajectory.times.tolist(),
            trajectory.states,
            rates,
            trajectory.control('torque').tolist(),
            strict=True,
        )
    ]
    return message


def pendulum_trajectory(
    message: JointTrajectory, interpolation: Interpolation | None = None
) -> Trajectory:
    """Read a pendulum's plan from a message; joints may come in any order.

    A JointTrajectory does not say how efforts run between its points. Unless `interpolation` says
    so, efforts that stay equal over most intervals are held (switched torque), others are read as
    the cubic spline through the points.

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
        interpolation = 'zero_order_hold' if held else 'cubic'
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


def _quantity(message: JointTrajectory, quantity: str, index: Sequence[int]) -> Array:
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
    """Return where the `wanted` joints stand among `names`.

    Raises
    ------
    InvalidProblem
        Naming the joints that are missing, or there twice.
    """
    listed = list(names)
    wrong = [name for name in wanted if listed.count(name) != 1]
    if wrong:
        found = ', '.join(listed) or 'none'
        raise InvalidProblem(
            f'joint(s) {", ".join(wrong)} must be named once, but the names are: {found}'
        )
    return [listed.index(name) for name in wanted]


def joint_motion(message: JointState, joints: Sequence[str]) -> Array:
    """Return positions and velocities of `joints` in a JointState, (2 n,): x1.., x1'...

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
            if not math.isfinite(row[i]):
                raise InvalidProblem(
                    f'the {quantity} of joint {joint} is {row[i]}, not a finite number'
                )
            values.append(float(row[i]))
    return np.array(values)
