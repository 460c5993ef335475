# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Small recordings written by `rosbags`, of motions that are known in closed form."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from page_missions import pendulum_plan, pendulum_states, robot_states
import pytest
from tdm_planner.problems import PendulumSwingUp, RobotFormation

START = 1_700_000_000_250_000_000  # ns: the first plan's motion starts
DURATION = 2.0
RATE = 100.0  # Hz of measurements
ERROR = 0.01  # of the first measured state

STANDARD = {
    'JointState': 'sensor_msgs/msg/JointState',
    'Odometry': 'nav_msgs/msg/Odometry',
    'JointTrajectory': 'trajectory_msgs/msg/JointTrajectory',
    'MultiDOFJointTrajectory': 'trajectory_msgs/msg/MultiDOFJointTrajectory',
    'String': 'std_msgs/msg/String',
    'DiagnosticArray': 'diagnostic_msgs/msg/DiagnosticArray',
    'GoalStatusArray': 'action_msgs/msg/GoalStatusArray',
    'Log': 'rcl_interfaces/msg/Log',
}


class Item(NamedTuple):
    """A message to record at `stamp` [ns]; `data` replaces its bytes."""

    topic: str
    type_name: str
    stamp: int
    message: Any
    data: bytes | None = None


@cache
def store() -> Any:
    typesys = pytest.importorskip('rosbags.typesys')
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


def made(kind: str, **fields: Any) -> Any:
    """Return a message of rosbags' classes."""
    return store().types[STANDARD.get(kind, kind)](**fields)


def stamp(nanoseconds: int) -> Any:
    return made(
        'builtin_interfaces/msg/Time',
        sec=int(nanoseconds // 10**9),
        nanosec=int(nanoseconds % 10**9),
    )


def header(nanoseconds: int, frame: str = '') -> Any:
    return made('std_msgs/msg/Header', stamp=stamp(nanoseconds), frame_id=frame)


def span(seconds: float) -> Any:
    nanoseconds = round(seconds * 1e9)
    return made(
        'builtin_interfaces/msg/Duration', sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )


def joint_state(at: int, names: Sequence[str], **values: Sequence[float] | np.ndarray) -> Any:
    arrays = {
        quantity: np.array(values.get(quantity, ()), dtype=float)
        for quantity in ('position', 'velocity', 'effort')
    }
    return made('JointState', header=header(at), name=list(names), **arrays)


def goal(start: int, status: int) -> Any:
    """Return what a tracker tells of the plan that starts at the instant [ns]."""
    identity = made('unique_identifier_msgs/msg/UUID', uuid=np.zeros(16, dtype=np.uint8))
    info = made('action_msgs/msg/GoalInfo', goal_id=identity, stamp=stamp(start))
    told = made('action_msgs/msg/GoalStatus', goal_info=info, status=status)
    return made('GoalStatusArray', status_list=[told])


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0, kind: str = 'Vector3') -> Any:
    return made(f'geometry_msgs/msg/{kind}', x=float(x), y=float(y), z=float(z))


def twist(x: float, y: float, turn: float) -> Any:
    return made('geometry_msgs/msg/Twist', linear=vector(x, y), angular=vector(z=turn))


def rotation(yaw: float) -> Any:
    z, w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
    return made('geometry_msgs/msg/Quaternion', x=0.0, y=0.0, z=z, w=w)


def odometry(at: int, name: str, state: Sequence[float] | np.ndarray, frame: str = 'arena') -> Any:
    """State x, y, u, v, yaw, omega in the arena's frame, as an odometry says it."""
    x, y, u, v, yaw, omega = (float(value) for value in state[:6])
    c, s = np.cos(yaw), np.sin(yaw)
    pose = made(
        'geometry_msgs/msg/Pose', position=vector(x, y, kind='Point'), orientation=rotation(yaw)
    )
    return made(
        'Odometry',
        header=header(at, frame),
        child_frame_id=name,
        pose=made('geometry_msgs/msg/PoseWithCovariance', pose=pose, covariance=np.zeros(36)),
        twist=made(
            'geometry_msgs/msg/TwistWithCovariance',
            twist=twist(c * u + s * v, -s * u + c * v, omega),
            covariance=np.zeros(36),
        ),
    )


def joint_plan(at: int, names: Sequence[str], times: Any, **rows: Any) -> Any:
    points = []
    for k, time in enumerate(times):
        values = {
            quantity: np.array(rows[quantity][k] if quantity in rows else (), dtype=float)
            for quantity in ('positions', 'velocities', 'accelerations', 'effort')
        }
        point = made(
            'trajectory_msgs/msg/JointTrajectoryPoint', **values, time_from_start=span(time)
        )
        points.append(point)
    return made('JointTrajectory', header=header(at), joint_names=list(names), points=points)


def summary(at: int, problem: str, parameters: Any, **more: Any) -> Any:
    document = {
        'plan_id': 1,
        'stamp': {'sec': at // 10**9, 'nanosec': at % 10**9},
        'problem': problem,
        'duration': DURATION,
        'cost': 1.25,
        'cost_terms': {},
        'penalty': 0.0,
        'solve_time': 0.125,
        'evaluations': 42,
        'summary': 'a plan',
        'verification': {
            'ok': True,
            'terminal_error': {},
            'worst': {},
            'worst_times': {},
            'units': {},
            'reasons': [],
        },
        'vehicles': {},
        'parameters': parameters,
    }
    return made('String', data=json.dumps({**document, **more}))


def status(at: int, node: str, level: int, message: str, **values: str) -> Any:
    pairs = [
        made('diagnostic_msgs/msg/KeyValue', key=key.replace('_', ' '), value=value)
        for key, value in values.items()
    ]
    item = made(
        'diagnostic_msgs/msg/DiagnosticStatus',
        level=level,
        name=f'{node}: x',
        message=message,
        hardware_id=node,
        values=pairs,
    )
    return made('DiagnosticArray', header=header(at), status=[item])


def log(at: int, level: int, node: str, text: str) -> Any:
    return made(
        'Log', stamp=stamp(at), level=level, name=node, msg=text, file='', function='', line=1
    )


def instants(start: float = -0.5, end: float = DURATION + 1.0) -> list[tuple[float, int]]:
    """Seconds since the start of the motion, and the instant [ns]."""
    times = np.arange(start, end, 1.0 / RATE)
    return [(float(t), START + round(float(t) * 1e9)) for t in times]


def pendulum_recording(namespace: str = '/pendulum') -> list[Item]:
    """Return a plan of the pendulum, and a measured motion that is off by `ERROR` in theta."""
    plan = pendulum_plan()
    units = {'theta': 'rad', 'psi': 'rad', 'theta_dot': 'rad/s', 'psi_dot': 'rad/s'}
    vehicle = {'interpolation': 'zero_order_hold', 'units': units, 'duration': DURATION}
    check = {
        'worst': {'torque': 0.006, 'disk_angle': 1.2},
        'worst_times': {'torque': 0.0, 'disk_angle': 2.0},
        'units': {'torque': 'N m', 'disk_angle': 'rad'},
        'terminal_error': {'theta': 1e-6},
    }
    found = [
        Item(
            f'{namespace}/trajectory',
            STANDARD['JointTrajectory'],
            START - 10**9,
            joint_plan(
                START,
                ('pendulum', 'disk'),
                plan.times,
                positions=plan.states[:, :2],
                velocities=plan.states[:, 2:],
                effort=np.concatenate([0 * plan.controls, plan.controls], axis=1),
            ),
        ),
        Item(
            f'{namespace}/plan_summary',
            STANDARD['String'],
            START - 10**9,
            summary(
                START,
                'pendulum_swing_up',
                PendulumSwingUp().to_parameters(),
                vehicles={'pendulum': vehicle},
                verification=check,
            ),
        ),
    ]
    for t, at in instants():
        theta, psi, *rates = pendulum_states(np.clip(t, 0.0, DURATION))
        torque = float(plan.sample(t).control[0]) if 0 <= t < DURATION else 0.0
        effort = {'effort': [0.0, torque]}
        joints = ('pendulum', 'disk')
        position = [theta + ERROR, psi]
        messages = {
            'joint_states': joint_state(at, joints, position=position, velocity=rates, **effort),
            'joint_command': joint_state(at, ('disk',), effort=[torque]),
            'tracking_error': joint_state(
                at, joints, position=[ERROR, 0.0], velocity=[0.0, 0.0], effort=[0.0, 0.0]
            ),
        }
        found += [
            Item(f'{namespace}/{name}', STANDARD['JointState'], at, message)
            for name, message in messages.items()
        ]
    return found


def robot_parameters(count: int) -> dict[str, Any]:
    """Return the parameters of robots that go as `robot_states` has it."""
    values: dict[str, Any] = {'robots': [f'robot{k + 1}' for k in range(count)]}
    values['formation.anchor'] = [0.0, 0.0, 0.0]
    for k, name in enumerate(values['robots']):
        start, end = robot_states(0.0, k), robot_states(DURATION, k)
        values |= {f'{name}.start.x': float(start[0]), f'{name}.start.y': float(start[1])}
        values[f'formation.{name}'] = [float(end[0]), float(end[1]), float(end[4])]
    return RobotFormation.from_parameters(values).to_parameters()


def robot_recording(namespace: str = '/robots', count: int = 2) -> list[Item]:
    """Plans of robots, and measured motions that are off by `ERROR` in x."""
    times = np.linspace(0.0, DURATION, 21)
    names = [f'robot{k + 1}' for k in range(count)]
    vehicles = {name: {'interpolation': 'linear', 'units': {}} for name in names}
    worst = {f'{name}.walls': 0.3 for name in names} | {'separation robot1-robot2': 0.6}
    found = [
        Item(
            f'{namespace}/plan_summary',
            STANDARD['String'],
            START - 10**9,
            summary(
                START,
                'robot_formation',
                robot_parameters(count),
                vehicles=vehicles,
                cost_terms={'time': 0.5, 'sequence': 0.25, 'gas': 0.5},
                verification={'worst': worst, 'worst_times': dict.fromkeys(worst, 0.5)},
            ),
        )
    ]
    for k, name in enumerate(names):
        found += _robot_plan(f'{namespace}/{name}', name, k, times)
        for t, at in instants():
            state = robot_states(np.clip(t, 0.0, DURATION), k)
            state[0] += ERROR
            thrust = 0.5 if 0 <= t < DURATION else 0.0
            joints = joint_state(
                at,
                ('reaction_wheel', 'thruster'),
                position=[0.0, state[6]],
                velocity=[0.0, 0.125],
                effort=[0.001, thrust],
            )
            found += [
                Item(f'{namespace}/{name}/odom', STANDARD['Odometry'], at,
                     odometry(at, name, state)),
                Item(f'{namespace}/{name}/joint_states', STANDARD['JointState'], at, joints),
            ]  # fmt: skip
    return found


def _robot_plan(namespace: str, name: str, number: int, times: Any) -> list[Item]:
    states = robot_states(times, number)
    points = [
        made(
            'trajectory_msgs/msg/MultiDOFJointTrajectoryPoint',
            transforms=[
                made(
                    'geometry_msgs/msg/Transform',
                    translation=vector(x, y),
                    rotation=rotation(yaw),
                )
            ],
            velocities=[twist(u, v, omega)],
            accelerations=[],
            time_from_start=span(t),
        )
        for t, (x, y, u, v, yaw, omega, _) in zip(times, states, strict=True)
    ]
    motion = made(
        'MultiDOFJointTrajectory', header=header(START, 'arena'), joint_names=[name], points=points
    )
    controls = joint_plan(
        START,
        ('thruster', 'reaction_wheel'),
        times,
        positions=np.stack([states[:, 6], 0 * times], axis=1),
        velocities=np.tile([0.125, 0.0], (times.size, 1)),
        effort=np.tile([0.5, 0.001], (times.size, 1)),
    )
    early = START - 10**9
    return [
        Item(f'{namespace}/trajectory', STANDARD['MultiDOFJointTrajectory'], early, motion),
        Item(f'{namespace}/controls', STANDARD['JointTrajectory'], early, controls),
    ]


def filling() -> list[Item]:
    """Return some 3 MB of log messages during the motion, so that a file has several blocks."""
    random = np.random.default_rng(1)
    times = [START + k * 10**7 for k in range(-50, 250)]
    return [
        Item('/rosout', STANDARD['Log'], at, log(at, 20, 'x', random.bytes(5000).hex()))
        for at in times
    ]


def write(path: Path, items: Iterable[Item], storage: str = 'mcap', compression: str = '') -> Path:
    """Write a rosbag2; `compression` is '', message, file or storage (within MCAP)."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    types = store()
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for item in sorted(items, key=lambda item: item.stamp):
            if item.topic not in connections:
                connections[item.topic] = writer.add_connection(
                    item.topic, item.type_name, typestore=types
                )
            data = item.data
            if data is None:
                data = types.serialize_cdr(item.message, item.type_name)
            writer.write(connections[item.topic], item.stamp, data)
    return path


def without(items: Iterable[Item], *endings: str) -> list[Item]:
    """Return the messages of all topics but those with such an end."""
    return [item for item in items if not item.topic.endswith(endings)]
