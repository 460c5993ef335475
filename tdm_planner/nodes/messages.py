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

"""Trajectories as ROS messages, exact to the nanosecond; `reading` reads them back."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Duration, Time
import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.nodes.frames import WORLD_FRAME
from tdm_planner.nodes.qos import LATCHED
from tdm_planner.nodes.reading import (
    joint_indices,
    joint_motion,
    nanoseconds_of,
    PENDULUM_CONTROLS,
    PENDULUM_JOINTS,
    PENDULUM_STATES,
    pendulum_trajectory,
    seconds_of,
)
from tdm_planner.trajectory import NANOSECOND, Trajectory
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

__all__ = [
    'LATCHED',
    'PENDULUM_CONTROLS',
    'PENDULUM_JOINTS',
    'PENDULUM_STATES',
    'WORLD_FRAME',
    'from_wire',
    'joint_indices',
    'joint_motion',
    'nanoseconds_of',
    'pendulum_message',
    'pendulum_trajectory',
    'seconds_of',
    'stamp_of',
    'to_duration',
    'to_stamp',
]

Array = NDArray[np.float64]

# Rates below it are rest: what a plan may be off by at its end [rad/s]. Trajectory controllers
# want the last velocities to be exactly zero (`allow_nonzero_velocity_at_trajectory_end`).
_AT_REST = 1e-3
_SECOND = 1_000_000_000  # ns


def to_stamp(nanoseconds: int) -> Time:
    """Instant [ns since the epoch] as a message."""
    return Time(sec=nanoseconds // _SECOND, nanosec=nanoseconds % _SECOND)


def from_wire(data: bytes, kind: type) -> Any:
    """
    Return a message of the type `kind` from its serialised form.

    Raises
    ------
    InvalidProblem
        If it is no such message.

    """
    try:
        return deserialize_message(data, kind)
    except RuntimeError:  # RMWError
        raise InvalidProblem(
            f'{len(data)} bytes came that are no {kind.__name__} message'
        ) from None


def stamp_of(data: bytes) -> Time:
    """
    Return the time stamp of a message that begins with a header, from its serialised form.

    Raises
    ------
    InvalidProblem
        If it does not even have a header.

    """
    return from_wire(data, Header).stamp  # what follows the header is not looked at


def to_duration(seconds: float) -> Duration:
    """Span of time [s], rounded to the nanosecond, as a message."""
    nanoseconds = round(seconds / NANOSECOND)
    return Duration(sec=nanoseconds // _SECOND, nanosec=nanoseconds % _SECOND)


def pendulum_message(trajectory: Trajectory, stamp: Time) -> JointTrajectory:
    """
    Return the pendulum's plan as a message; `stamp` is the instant at which the motion starts.

    Joints [pendulum, disk]: positions [theta, psi], their rates (exactly zero at the end of a
    motion that ends at rest), accelerations (where torque jumps, those after the jump) and effort
    [0, T]. Of torque that is held the last one acts for no time and is 0: a controller that keeps
    the last point must not keep a torque.

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
    states = trajectory.states.copy()
    if (np.abs(states[-1, 2:]) < _AT_REST).all():
        states[-1, 2:] = 0.0
    torques = trajectory.control('torque').tolist()
    if trajectory.interpolation == 'zero_order_hold':
        torques[-1] = 0.0
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
            trajectory.times.tolist(), states, rates, torques, strict=True
        )
    ]
    return message
