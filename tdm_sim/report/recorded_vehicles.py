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
Vehicles of a recording, found by their topics; measured histories by the names of the plans'.

Topics are told by their last name and by what is in them, in whichever namespace they stand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from tdm_planner.plant_kind import ARENA_FRAME, PENDULUM, QUANTITIES, ROBOT
from tdm_planner.plants.floating_robot import FloatingRobot
from tdm_planner.plants.rotary_pendulum import RotaryPendulum
from tdm_planner.trajectory import NANOSECOND
from tdm_sim.report.mission import PlanInForce, Plant, Signals
from tdm_sim.report.recorded_plans import is_pendulum
from tdm_sim.report.recorded_topics import (
    JOINT_PLAN,
    JOINT_STATE,
    ODOMETRY,
    RecordedTopics,
    Stream,
)

Array = NDArray[np.float64]

_TURN = 2 * np.pi
_PENDULUM_JOINTS = {joint.name for joint in PENDULUM.joints}
_ROBOT_JOINTS = {joint.name for joint in ROBOT.actuated}


@dataclass(frozen=True)
class Site:
    """Where a vehicle's topics stand, what it is, and where its planner's do."""

    namespace: str
    plant: Plant
    planner: str


def namespace_of(topic: str) -> str:
    """Return the namespace of a topic, without a slash at its end."""
    return topic.rsplit('/', 1)[0]


def find_sites(topics: RecordedTopics, summaries: Mapping[str, object]) -> list[Site]:
    """Return every vehicle; `summaries` has the namespaces in which planners told of plans."""
    plants: dict[str, Plant] = {}
    for topic, kind in sorted(topics.types.items()):
        found = _plant_of(topics, topic, kind)
        namespace = namespace_of(topic)
        if found is not None and plants.get(namespace, 'other') == 'other':
            plants[namespace] = found
    sites = []
    for namespace, plant in plants.items():
        planner = _planner_of(namespace, plant, summaries)
        if planner is not None:
            sites.append(Site(namespace, plant, planner))
    return sites


def _planner_of(namespace: str, plant: Plant, summaries: Mapping[str, object]) -> str | None:
    above = namespace_of(namespace)
    for candidate in (namespace, above):
        if candidate in summaries:
            return candidate
    if plant == 'other':
        return None  # topics called `trajectory` and `joint_states` are not ours alone
    return above if plant == 'robot' else namespace


def _plant_of(topics: RecordedTopics, topic: str, kind: str) -> Plant | None:
    """Return the plant that a topic tells of."""
    name = topic.rsplit('/', 1)[-1]
    if kind == JOINT_PLAN and name == 'trajectory':
        received = topics.messages.get(topic)
        if not received:
            return None
        if is_pendulum(received[0].message):
            return 'pendulum'
        return 'robot' if set(received[0].message.joint_names) >= _ROBOT_JOINTS else 'other'
    if kind == ODOMETRY and name == 'odom':
        return 'robot' if topics.streams[topic].frame == ARENA_FRAME else None
    if kind == JOINT_STATE and name in ('joint_states', 'joint_command'):
        joints = list(topics.streams[topic].joints)
        if set(joints) >= _PENDULUM_JOINTS:
            return 'pendulum'
        return 'robot' if set(joints) >= _ROBOT_JOINTS else 'other'
    return None


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured of a vehicle, and what it was told."""

    states: Signals | None
    commands: Signals | None
    applied: Signals | None
    tracking_error: Signals | None


def measured(
    topics: RecordedTopics, site: Site, origin: int, plans: tuple[PlanInForce, ...]
) -> Measured:
    """
    Return measured states and controls, times from `origin` [ns].

    Angles of robots are unwrapped, and counted on the turn on which the first plan starts.
    """

    def stream(name: str, kind: str) -> Stream | None:
        found = topics.streams.get(f'{site.namespace}/{name}')
        right = topics.types.get(f'{site.namespace}/{name}') == kind
        return found if found is not None and right and found.instants.size else None

    joints, command = stream('joint_states', JOINT_STATE), stream('joint_command', JOINT_STATE)
    error = stream('tracking_error', JOINT_STATE)
    errors = None if error is None else _errors(error, site.plant, origin)
    if site.plant == 'pendulum':
        return Measured(
            states=None if joints is None else _pendulum_states(joints, origin),
            commands=None if command is None else _pendulum_controls(command, origin),
            applied=None if joints is None else _pendulum_controls(joints, origin),
            tracking_error=errors,
        )
    if site.plant == 'robot':
        odometry = stream('odom', ODOMETRY)
        states = None if odometry is None else _robot_states(odometry, joints, origin)
        return Measured(
            states=None if states is None else _on_planned_turn(states, plans),
            commands=None if command is None else _robot_controls(command, origin),
            applied=None if joints is None else _robot_controls(joints, origin),
            tracking_error=errors,
        )
    states = None if joints is None else _named(joints, origin, plans, 'states')
    commands = None if command is None else _named(command, origin, plans, 'controls')
    return Measured(states, commands, None, errors)


def _signals(
    stream: Stream, origin: int, columns: Mapping[str, Array], units: Mapping[str, str]
) -> Signals | None:
    """Return histories; None if nothing at all was measured."""
    values = np.stack(list(columns.values()), axis=1)
    if np.isnan(values).all():
        return None
    times = np.asarray((stream.instants - origin) * NANOSECOND, dtype=np.float64)
    return Signals(times, values, tuple(columns), tuple(units.get(name, '') for name in columns))


_PENDULUM_UNITS = dict(zip(PENDULUM.state_names, RotaryPendulum.state_units, strict=True))
_ROBOT_UNITS = {
    **dict(zip(ROBOT.state_names, FloatingRobot.state_units, strict=True)),
    **dict(zip(FloatingRobot.control_names, FloatingRobot.control_units, strict=True)),
}


def _pendulum_states(joints: Stream, origin: int) -> Signals | None:
    columns = {
        'theta': joints.column('pendulum.position'),
        'psi': joints.column('disk.position'),
        'theta_dot': joints.column('pendulum.velocity'),
        'psi_dot': joints.column('disk.velocity'),
    }
    return _signals(joints, origin, columns, _PENDULUM_UNITS)


def _pendulum_controls(stream: Stream, origin: int) -> Signals | None:
    return _signals(stream, origin, {'torque': stream.column('disk.effort')}, {'torque': 'N m'})


def _robot_states(odometry: Stream, joints: Stream | None, origin: int) -> Signals | None:
    qx, qy, qz, qw = (odometry.column(name) for name in ('qx', 'qy', 'qz', 'qw'))
    yaw = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    yaw[~(np.abs(np.sqrt(qx**2 + qy**2 + qz**2 + qw**2) - 1.0) < 1e-3)] = np.nan
    c, s = np.cos(yaw), np.sin(yaw)
    vx, vy = odometry.column('vx'), odometry.column('vy')
    columns = {
        'x': odometry.column('x'),
        'y': odometry.column('y'),
        'u': c * vx - s * vy,
        'v': s * vx + c * vy,
        'yaw': _unwrapped(yaw),
        'omega': odometry.column('omega'),
    }
    if joints is not None:
        columns['alpha'] = np.interp(
            odometry.instants.astype(float),
            joints.instants.astype(float),
            joints.column('thruster.position'),
            left=np.nan,
            right=np.nan,
        )
    return _signals(odometry, origin, columns, _ROBOT_UNITS)


def _robot_controls(stream: Stream, origin: int) -> Signals | None:
    columns = {
        'thrust': stream.column('thruster.effort'),
        'thruster_rate': stream.column('thruster.velocity'),
        'torque': stream.column('reaction_wheel.effort'),
    }
    return _signals(stream, origin, columns, _ROBOT_UNITS)


def _unwrapped(angle: Array) -> Array:
    known = ~np.isnan(angle)
    unwrapped = angle.copy()
    unwrapped[known] = np.unwrap(angle[known])
    return unwrapped


def _on_planned_turn(states: Signals, plans: tuple[PlanInForce, ...]) -> Signals:
    """Shift angles by whole turns to where the first plan that was followed has them."""
    for plan in plans:
        values = states.values.copy()
        for name in {'yaw', 'alpha'} & set(states.names) & set(plan.trajectory.state_names):
            k = states.names.index(name)
            planned = plan.states(states.times)[:, plan.trajectory.state_names.index(name)]
            during = (states.times >= plan.start) & (states.times <= plan.carried_out_until)
            away = values[during, k] - planned[during]
            if np.isfinite(away).any():
                first = away[np.isfinite(away)][0]
                values[:, k] -= _TURN * np.round(first / _TURN)
        return Signals(states.times, values, states.names, states.units)
    return states


def _named(
    stream: Stream, origin: int, plans: tuple[PlanInForce, ...], group: str
) -> Signals | None:
    """States or controls of a plan, by the joints of a JointState that they are."""
    kind = plans[-1].kind if plans else None
    if kind is None:
        return None
    wanted = kind.state_names if group == 'states' else kind.control_names
    columns = {
        getattr(joint, what): stream.column(f'{joint.name}.{what}')
        for joint in kind.joints
        for what in QUANTITIES
        if getattr(joint, what) in wanted and f'{joint.name}.{what}' in stream.columns
    }
    return _signals(stream, origin, columns, plans[-1].trajectory.units) if columns else None


# What a tracker's joints say, by the names of the states; and their units.
_ERRORS: Mapping[str, tuple[Mapping[str, str], Mapping[str, str]]] = MappingProxyType(
    {
        'pendulum': (
            {
                'theta': 'pendulum.position',
                'psi': 'disk.position',
                'theta_dot': 'pendulum.velocity',
                'psi_dot': 'disk.velocity',
            },
            _PENDULUM_UNITS,
        ),
        'robot': (
            {
                'x': 'x.position',
                'y': 'y.position',
                'u': 'x.velocity',
                'v': 'y.velocity',
                'yaw': 'yaw.position',
                'omega': 'yaw.velocity',
                'alpha': 'thruster.position',
            },
            _ROBOT_UNITS,
        ),
    }
)


def _errors(stream: Stream, plant: Plant, origin: int) -> Signals | None:
    """Return what the tracker says of its errors, by the names of the states."""
    if plant in _ERRORS:
        sources, units = _ERRORS[plant]
        columns = {name: stream.column(source) for name, source in sources.items()}
        return _signals(stream, origin, columns, units)
    columns = {
        joint: stream.column(f'{joint}.position')
        for joint in stream.joints
        if f'{joint}.position' in stream.columns
    }
    return _signals(stream, origin, columns, {}) if columns else None
