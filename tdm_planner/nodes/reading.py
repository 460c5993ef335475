# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Reads plans, states and commands from messages of any library.

This module needs no ROS: nodes read rclpy's messages with it, a report those of a recording. A
plant's `PlantKind` says which joints they have.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from enum import IntEnum
import math
from typing import Any

import numpy as np
from tdm_planner.arrays import Array
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameters import LARGEST, shown
from tdm_planner.plant_kind import Joint, PlantKind, QUANTITIES
from tdm_planner.trajectory import Interpolation, NANOSECOND, SECOND, Trajectory

_FEW_VALUES = 8  # of an effort that is held, however seldom it acts
_UNIT_TOLERANCE, _LEANING = 1e-3, 0.1  # of a quaternion: of its length, and its part x, y
_FIELDS = ('positions', 'velocities', 'effort')  # of a trajectory's points, as `QUANTITIES`
_FIT, _RESTING = 0.1, 1e-6  # share of a state's largest rate that is no fit; rates at rest
_RATES = ('velocities', 'accelerations', 'effort')  # where the rates of those that are states are


class Level(IntEnum):
    """Levels of a diagnostic status, as DiagnosticStatus numbers them."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def nanoseconds_of(message: Any) -> int:
    """Instant or span of a Time or Duration message [ns], without loss."""
    return int(message.sec) * SECOND + int(message.nanosec)


def seconds_of(message: Any) -> float:
    """Instant or span of a Time or Duration message [s]; an instant loses 0.2 us in a float."""
    return nanoseconds_of(message) * NANOSECOND


def read_plan(
    kind: PlantKind,
    message: Any,
    interpolation: Interpolation | None = None,
    *,
    rated: bool = False,
) -> Trajectory:
    """
    Read a plan from a JointTrajectory; joints may come in any order.

    A message does not say how controls run between its points. Unless `interpolation` or the
    plant's kind says so, efforts that stay equal over most intervals are held (switched controls),
    others are read as linear between the points; so are those that are zero for long, but take
    ever new values else. `rated` says that velocities and accelerations
    are the rates of the states, as a planner of ours writes them if it knows them. States are read
    by them between the points where they fit, and controls are not held: those have two rates at a
    switch.

    Raise InvalidProblem for another frame, joints that are missing, lengths that do not match,
    values that are not finite, or times that do not increase strictly from 0 or later.
    """
    check_frame(kind, message, 'trajectory')
    points, known = message.points, {*kind.state_names, *kind.control_names}
    if len(points) < 2:
        raise InvalidProblem(
            f"trajectory 'points' has {len(points)} points: at least two are needed"
        )
    told = "trajectory '{}' of point {} has {} values for {} joints: one for each is needed"
    columns = _columns(kind.joints, message.joint_names, known, points, _FIELDS, told)

    def stacked(names: Sequence[str]) -> Array:
        values = np.array([columns[name] for name in names], dtype=float)
        return values.reshape(len(names), len(points)).T

    efforts = stacked([joint.effort for joint in kind.joints if joint.effort in known])
    plan = Trajectory.of(
        kind,
        _instants(points),
        stacked(kind.state_names),
        stacked(kind.control_names),
        interpolation or kind.interpolation or _looks_like(efforts),
    )
    if not rated or plan.interpolation == 'zero_order_hold':
        return plan
    columns = _columns(kind.joints, message.joint_names, {*kind.state_names}, points, _RATES, told)
    rates, slopes = stacked(kind.state_names), np.diff(plan.states.T) / np.diff(plan.times)
    away = np.abs(0.5 * (rates[:-1] + rates[1:]).T - slopes)
    if not (away <= _FIT * np.abs(slopes).max(axis=1, keepdims=True) + _RESTING).all():
        return plan
    return replace(plan, rates=np.stack([rates[:-1], rates[1:]], axis=1))


def _columns(
    joints: Sequence[Joint],
    names: Sequence[str],
    known: Collection[str],
    points: Sequence[Any],
    fields: Sequence[str],
    told: str,
) -> dict[str, list[float]]:
    """
    Return the `known` states and controls of joints at all points, by name.

    A point has `fields` with the `QUANTITIES` of the joints `names`; `told` says where it has not.
    """
    listed, columns = list(names), dict[str, list[float]]()
    wrong = [joint.name for joint in joints if listed.count(joint.name) != 1]
    if wrong:
        found = shown(', '.join(listed)) or 'none'
        raise InvalidProblem(
            f'joint(s) {", ".join(wrong)} must be named once, but the names are: {found}'
        )
    for quantity, field in zip(QUANTITIES, fields, strict=True):
        places = {getattr(joint, quantity): listed.index(joint.name) for joint in joints}
        wanted = {name: place for name, place in places.items() if name in known}
        rows = [getattr(point, field) for point in points] if wanted else []
        for number, row in enumerate(rows):
            if len(row) != len(listed):
                raise InvalidProblem(told.format(field, number, len(row), len(listed)))
        columns |= {name: [float(row[place]) for row in rows] for name, place in wanted.items()}
    return columns


def _looks_like(efforts: Array) -> Interpolation:
    for effort in efforts[:-1].T:
        acting, changes = effort[effort != 0.0], np.count_nonzero(np.diff(effort))
        values = np.unique(acting).size
        if changes > (effort.size - 1) / 2 or values > max(_FEW_VALUES, acting.size / 2):
            return 'linear'
    return 'zero_order_hold'


def _instants(points: Sequence[Any]) -> Array:
    nanoseconds = np.array([nanoseconds_of(p.time_from_start) for p in points], dtype=float)
    if nanoseconds[0] < 0:
        raise InvalidProblem(
            f"trajectory 'time_from_start' of point 0 is {nanoseconds[0] * NANOSECOND:g} s: must "
            'be in [0, inf) s'
        )
    return np.asarray(nanoseconds * NANOSECOND)


def check_frame(kind: PlantKind, message: Any, what: str, *, named: bool = False) -> None:
    """Raise InvalidProblem for another frame than the plant's; '' passes unless it is `named`."""
    allowed = {kind.frame} if named else {'', kind.frame}
    if kind.odometry and message.header.frame_id not in allowed:
        raise InvalidProblem(
            f"{what} 'frame_id' = '{shown(message.header.frame_id)}' must be '{kind.frame}'"
        )


def read_joints(joints: Sequence[Joint], message: Any, names: Iterable[str]) -> dict[str, float]:
    """
    Return those of `names` (states or controls) that `joints` have in a JointState.

    Raise InvalidProblem for joints that are missing, lengths that do not match, or values that are
    not finite.
    """
    told = "'{0}' has {2} values for {3} named joints"
    columns = _columns(joints, message.name, set(names), [message], QUANTITIES, told)
    values = {name: value for name, (value,) in columns.items()}
    for quantity in QUANTITIES:
        for joint in joints:
            value = values.get(getattr(joint, quantity), 0.0)
            if not abs(value) <= LARGEST:
                raise InvalidProblem(
                    f'the {quantity} of joint {joint.name} is {value}, not a finite '
                    f'number of at most {LARGEST:g}'
                )
    return values


def read_command(kind: PlantKind, message: Any) -> Array:
    """
    Return the controls (nu,) of a command.

    Raise InvalidProblem as `read_joints` does.
    """
    values = read_joints(kind.actuated, message, kind.control_names)
    return np.array([values[name] for name in kind.control_names])


def read_odometry(kind: PlantKind, message: Any) -> dict[str, float]:
    """
    Return the states that an odometry measures; its twist is turned into the pose's frame.

    That is not necessary where `child_frame_id`, the frame of the twist, is the plant's as well.

    Raise InvalidProblem if the frame is another, a value is not finite, or the quaternion not of
    unit length.
    """
    check_frame(kind, message, 'odometry')
    place, rates = message.pose.pose.position, message.twist.twist
    yaw = yaw_of(message.pose.pose.orientation)
    turn = 0.0 if message.child_frame_id == kind.frame else yaw
    c, s = math.cos(turn), math.sin(turn)
    motion = (  # values and rates
        (place.x, c * rates.linear.x - s * rates.linear.y),
        (place.y, s * rates.linear.x + c * rates.linear.y),
        (yaw, rates.angular.z),
    )
    joints = {joint.name: joint for joint in kind.joints}
    found: dict[str, float] = {}
    for name, values in zip(kind.odometry, motion, strict=True):
        found |= zip((joints[name].position, joints[name].velocity), values, strict=True)
    if not all(abs(value) <= LARGEST for value in found.values()):
        raise InvalidProblem(
            f'the odometry holds a value that is not a finite number of at most {LARGEST:g}'
        )
    return found


def yaw_of(rotation: Any) -> float:
    """
    Return the angle about the vertical [rad], in [-pi, pi].

    Raise InvalidProblem if the quaternion is not of unit length, or leans by more than some 10
    degrees.
    """
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(length - 1.0) < _UNIT_TOLERANCE:
        raise InvalidProblem(
            f'the orientation ({x:g}, {y:g}, {z:g}, {w:g}) has length {length:g}: must be a unit '
            'quaternion'
        )
    if math.hypot(x, y) > _LEANING:
        raise InvalidProblem(
            f'the orientation ({x:g}, {y:g}, {z:g}, {w:g}) is upside down or leans: must be a '
            'rotation about z'
        )
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
