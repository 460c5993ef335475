# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Recordings of the motions of missions.py, measured with an `ERROR` in the first state.

`pendulum_recording` and `robot_recording` are their messages, to leave out (`without`), add or
change some, and to `write` a bag; `check_pendulum` compares what is read of it. `made` builds any
message of rosbags' classes from nested mappings: what is not given is zero or empty. An `Item` is
a message to record under a topic at an instant [ns]; the first plan's motion starts at `START`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
import json
from pathlib import Path
from typing import Any, NamedTuple

from missions import (
    ANGLE_UNITS,
    DURATION,
    pendulum_plan,
    pendulum_states,
    robot_parameters,
    robot_states,
)
import numpy as np
import pytest
from tdm_planner.problems import PendulumSwingUp
from tdm_sim.report.mission import Mission

START = 1_700_000_000_250_000_000  # ns
SECOND = 10**9
RATE = 100.0  # Hz of measurements
ERROR = 0.01  # of the first measured state
JOINTS = ('pendulum', 'disk')


class Item(NamedTuple):
    """A message to record under a topic at `stamp` [ns]; `data` replaces its bytes."""

    topic: str
    stamp: int
    message: Any
    data: bytes | None = None


@cache
def store() -> Any:
    typesys = pytest.importorskip('rosbags.typesys')
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


def made(kind: str, **fields: Any) -> Any:
    """Return a message ('package/Name'), of nested mappings."""
    kind = kind.replace('/', '/msg/')
    _, members = store().fielddefs[kind]
    assert set(fields) <= {name for name, _ in members}
    return store().types[kind](**{name: _filled(of, fields.get(name)) for name, of in members})


def _filled(of: tuple[Any, Any], value: Any) -> Any:
    form, detail = of
    if form.name == 'NAME':
        if value is not None and not isinstance(value, Mapping):
            return value  # a message
        return made(detail.replace('/msg/', '/'), **(value or {}))
    if form.name == 'BASE':
        return ('' if detail[0] == 'string' else 0) if value is None else value
    element, length = detail
    if element[0].name == 'BASE' and element[1][0] != 'string':
        given = np.zeros(length if form.name == 'ARRAY' else 0) if value is None else value
        return np.array(given, dtype=element[1][0])
    return [_filled(element, item) for item in (() if value is None else value)]


def stamp(at: int) -> dict[str, int]:
    """Time or duration of so many nanoseconds."""
    return {'sec': at // SECOND, 'nanosec': at % SECOND}


def header(at: int, frame: str = '') -> Any:
    return made('std_msgs/Header', stamp=stamp(at), frame_id=frame)


def string(data: str) -> Any:
    return made('std_msgs/String', data=data)


def joint_state(at: int, names: Sequence[str], **values: Any) -> Any:
    return made('sensor_msgs/JointState', header=header(at), name=list(names), **values)


def goal(start: int, status: int) -> Any:
    """Return what a tracker tells of the plan that starts at the instant [ns]."""
    told = {'goal_info': {'stamp': stamp(start)}, 'status': status}
    return made('action_msgs/GoalStatusArray', status_list=[told])


def rotation(yaw: float) -> dict[str, float]:
    return {'z': float(np.sin(yaw / 2)), 'w': float(np.cos(yaw / 2))}


def odometry(at: int, name: str, state: Any, frame: str = 'arena') -> Any:
    """State x, y, u, v, yaw, omega in the arena's frame, as an odometry says it."""
    x, y, u, v, yaw, omega = (float(value) for value in state[:6])
    c, s = np.cos(yaw), np.sin(yaw)
    velocity = {'x': float(c * u + s * v), 'y': float(-s * u + c * v)}
    return made(
        'nav_msgs/Odometry',
        header=header(at, frame),
        child_frame_id=name,
        pose={'pose': {'position': {'x': x, 'y': y}, 'orientation': rotation(yaw)}},
        twist={'twist': {'linear': velocity, 'angular': {'z': omega}}},
    )


def joint_plan(at: int, names: Sequence[str], times: Any, **rows: Any) -> Any:
    points = [
        {
            **{quantity: values[k] for quantity, values in rows.items()},
            'time_from_start': stamp(round(time * SECOND)),
        }
        for k, time in enumerate(times)
    ]
    kind = 'trajectory_msgs/JointTrajectory'
    return made(kind, header=header(at), joint_names=list(names), points=points)


def summary(at: int, problem: str, parameters: Any, **more: Any) -> Any:
    document = {
        'plan_id': 1,
        'stamp': stamp(at),
        'problem': problem,
        'duration': DURATION,
        'cost': 1.25,
        'cost_terms': {},
        'penalty': 0.0,
        'solve_time': 0.125,
        'evaluations': 42,
        'summary': 'a plan',
        'verification': {},
        'vehicles': {},
        'parameters': parameters,
    }
    return string(json.dumps(document | more))


def status(at: int, node: str, level: int, message: str, **values: Any) -> Any:
    """Diagnostics of a node; of the names of values the underscores are spaces."""
    told = {
        'level': level,
        'name': f'{node}: x',
        'message': message,
        'hardware_id': node,
        'values': [{'key': k.replace('_', ' '), 'value': str(v)} for k, v in values.items()],
    }
    return made('diagnostic_msgs/DiagnosticArray', header=header(at), status=[told])


def log(at: int, level: int, node: str, text: str) -> Any:
    return made('rcl_interfaces/Log', stamp=stamp(at), level=level, name=node, msg=text, line=1)


def instants(start: float = -0.5, end: float = DURATION + 1.0) -> list[tuple[float, int]]:
    """Seconds since the start of the motion, and the instant [ns]."""
    times = np.arange(start, end, 1.0 / RATE)
    return [(float(t), START + round(float(t) * SECOND)) for t in times]


def pendulum_recording(namespace: str = '/pendulum') -> list[Item]:
    """Return a plan of the pendulum, and a measured motion that is off by `ERROR` in theta."""
    plan, early = pendulum_plan(), START - SECOND
    units = dict(zip(plan.state_names, ANGLE_UNITS, strict=True))
    vehicle = {'interpolation': 'zero_order_hold', 'units': units, 'duration': DURATION}
    check = {
        'worst': {'torque': 0.006, 'disk_angle': 1.2},
        'worst_times': {'torque': 0.0, 'disk_angle': 2.0},
        'units': {'torque': 'N m', 'disk_angle': 'rad'},
        'terminal_error': {'theta': 1e-6},
    }
    motion = joint_plan(
        START,
        JOINTS,
        plan.times,
        positions=plan.states[:, :2],
        velocities=plan.states[:, 2:],
        effort=plan.controls * [0.0, 1.0],
    )
    said = summary(
        START,
        'pendulum_swing_up',
        PendulumSwingUp().to_parameters(),
        vehicles={'pendulum': vehicle},
        verification=check,
    )
    found = [
        Item(f'{namespace}/trajectory', early, motion),
        Item(f'{namespace}/plan_summary', early, said),
    ]
    for t, at in instants():
        theta, psi, *rates = pendulum_states(np.clip(t, 0.0, DURATION))
        torque = float(plan.sample(t).control[0]) if 0 <= t < DURATION else 0.0
        measured = {'position': [theta + ERROR, psi], 'velocity': rates, 'effort': [0.0, torque]}
        errors = {'position': [ERROR, 0.0], 'velocity': [0.0, 0.0], 'effort': [0.0, 0.0]}
        found += [
            Item(f'{namespace}/joint_states', at, joint_state(at, JOINTS, **measured)),
            Item(f'{namespace}/joint_command', at, joint_state(at, ('disk',), effort=[torque])),
            Item(f'{namespace}/tracking_error', at, joint_state(at, JOINTS, **errors)),
        ]
    return found


def robot_recording(namespace: str = '/robots', count: int = 2) -> list[Item]:
    """Plans of robots, and measured motions that are off by `ERROR` in x."""
    names = [f'robot{k + 1}' for k in range(count)]
    worst = {f'{name}.walls': 0.3 for name in names} | {'separation robot1-robot2': 0.6}
    said = summary(
        START,
        'robot_formation',
        robot_parameters(count),
        vehicles={name: {'interpolation': 'linear', 'units': {}} for name in names},
        cost_terms={'time': 0.5, 'sequence': 0.25, 'gas': 0.5},
        verification={'worst': worst, 'worst_times': dict.fromkeys(worst, 0.5)},
    )
    found = [Item(f'{namespace}/plan_summary', START - SECOND, said)]
    for k, name in enumerate(names):
        found += _robot_plan(f'{namespace}/{name}', k)
        for t, at in instants():
            state = robot_states(np.clip(t, 0.0, DURATION), k) + ERROR * np.eye(7)[0]
            joints = joint_state(
                at,
                ('reaction_wheel', 'thruster'),
                position=[0.0, state[6]],
                velocity=[0.0, 0.125],
                effort=[0.001, 0.5 if 0 <= t < DURATION else 0.0],
            )
            found += [
                Item(f'{namespace}/{name}/odom', at, odometry(at, name, state)),
                Item(f'{namespace}/{name}/joint_states', at, joints),
            ]
    return found


def _robot_plan(namespace: str, number: int) -> list[Item]:
    times = np.linspace(0.0, DURATION, 21)
    x, y, u, v, yaw, omega, alpha = robot_states(times, number).T
    zero, one = np.zeros(times.size), np.ones(times.size)
    plan = joint_plan(
        START,
        ('x', 'y', 'yaw', 'thruster', 'reaction_wheel'),
        times,
        positions=np.stack([x, y, yaw, alpha, zero], axis=1),
        velocities=np.stack([u, v, omega, 0.125 * one, zero], axis=1),
        effort=np.stack([zero, zero, zero, 0.5 * one, 0.001 * one], axis=1),
    )
    return [Item(f'{namespace}/trajectory', START - SECOND, plan)]


def filling() -> list[Item]:
    """Return some 3 MB of log messages during the motion, so that a file has several blocks."""
    random = np.random.default_rng(1)
    times = [START + k * 10**7 for k in range(-50, 250)]
    return [Item('/rosout', at, log(at, 20, 'x', random.bytes(5000).hex())) for at in times]


def without(items: Iterable[Item], *endings: str) -> list[Item]:
    """Return the messages of all topics but those with such an end."""
    return [item for item in items if not item.topic.endswith(endings)]


def write(path: Path, items: Iterable[Item], storage: str = 'mcap', compression: str = '') -> Path:
    """Write a rosbag2; `compression` is '', message, file or storage (within MCAP)."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, at, message, data in sorted(items, key=lambda item: item.stamp):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store())
            if data is None:
                data = store().serialize_cdr(message, kind)
            writer.write(connections[topic], at, data)
    return path


def after(seconds: float) -> int:
    """Return an instant [ns] from the start of the motion on."""
    return START + round(seconds * 1e9)


def told(mission: Mission, sentence: str) -> bool:
    return any(sentence in text for text in mission.missing)


def check_pendulum(mission: Mission) -> None:
    """Compare with the closed form of what was recorded."""
    (vehicle,) = mission.vehicles
    assert (vehicle.name, vehicle.view.name) == ('pendulum', 'pendulum')
    (plan,) = vehicle.plans
    expected = pendulum_plan()
    assert (plan.plan_id, plan.start, plan.until) == ('1', 0.0, None)
    assert plan.trajectory.interpolation == 'zero_order_hold'
    np.testing.assert_allclose(plan.trajectory.times, expected.times, atol=1e-9)
    np.testing.assert_array_equal(plan.trajectory.states, expected.states)
    np.testing.assert_array_equal(plan.trajectory.controls, expected.controls)
    states = vehicle.states
    assert states is not None
    np.testing.assert_allclose(states.times, [t for t, _ in instants()], atol=1e-8)
    moved = pendulum_states(np.clip(states.times, 0.0, DURATION)) + ERROR * np.eye(4)[0]
    np.testing.assert_allclose(states.values, moved, atol=1e-7)
    for controls in (vehicle.applied, vehicle.commands):
        assert controls is not None
        assert controls.names == ('torque',)
        assert np.abs(controls.values).max() == 0.014
    assert vehicle.tracking_error is not None
    assert vehicle.tracking_error.column('theta').tolist() == [ERROR] * len(instants())
    (figures,) = mission.figures
    assert (figures.cost, figures.solve_time, figures.evaluations) == (1.25, 0.125, 42)
    assert figures.margins['disk_angle'].instant == 2.0
    assert vehicle.view.bounds()['torque'] == (-0.02, 0.02)
    assert mission.recorded_at == pytest.approx(START * 1e-9)
