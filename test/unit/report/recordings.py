# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Recordings of missions.

`recorded` makes the messages of a mission, such as those of missions.py (`pendulum_recording`,
`robot_recording`), to leave out (`without`), add or change some, and to `write` a bag;
`check_vehicles` compares what is read of it. `made` builds any message of rosbags' classes from
nested mappings: what is not given is zero or empty. An `Item` is a message to record under a topic
at an instant [ns]; the first plan's motion starts at `START`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
import json
from pathlib import Path
from typing import Any, NamedTuple

from missions import DURATION, formation_mission, pendulum_mission
import numpy as np
import pytest
from tdm_planner.plant_kind import Joint, QUANTITIES
from tdm_sim.report.mission import Mission, Signals

START = 1_700_000_000_250_000_000  # ns
SECOND = 10**9


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


def joint_plan(at: int, joints: Sequence[Joint], times: Any, columns: Mapping[str, Any]) -> Any:
    """Return a plan by the samples of states and controls."""
    rows = _rows(joints, columns)
    points = [
        {
            'positions': rows['position'][k],
            'velocities': rows['velocity'][k],
            'effort': rows['effort'][k],
            'time_from_start': stamp(round(time * SECOND)),
        }
        for k, time in enumerate(times)
    ]
    names = [joint.name for joint in joints]
    kind = 'trajectory_msgs/JointTrajectory'
    return made(kind, header=header(at), joint_names=names, points=points)


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


def recorded(mission: Mission, namespace: str, **told: Any) -> list[Item]:
    """Return what nodes publish of a mission; `told` is in the plan's summary besides."""
    found, vehicles = [], {}
    for vehicle in mission.vehicles:
        kind, plan = vehicle.view.kind, vehicle.plans[0].trajectory
        space = f'{namespace}/{vehicle.name}' if kind.odometry else namespace
        table = {j.name: {q: getattr(j, q) for q in QUANTITIES} for j in kind.joints}
        vehicles[vehicle.name] = {
            'interpolation': plan.interpolation, 'units': plan.units, 'joints': table,
        }  # fmt: skip
        columns = dict(zip(plan.state_names, plan.states.T, strict=True))
        columns |= zip(plan.control_names, plan.controls.T, strict=True)
        motion = joint_plan(START, kind.joints, plan.times, columns)
        found.append(Item(f'{space}/trajectory', START - SECOND, motion))
        within = [joint for joint in kind.joints if joint.name not in kind.odometry]
        for name, joints, histories in (
            ('joint_states', within[::-1], (vehicle.states, vehicle.applied)),
            ('joint_command', kind.actuated, (vehicle.commands,)),
            ('tracking_error', kind.joints, (vehicle.tracking_error,)),
        ):
            found += _joint_states(f'{space}/{name}', joints, histories)
        if kind.odometry and vehicle.states is not None:
            for at, state in zip(vehicle.states.times, vehicle.states.values, strict=True):
                stamp = after(at)
                found.append(Item(f'{space}/odom', stamp, odometry(stamp, vehicle.name, state)))
    parameters = dict(mission.parameters)
    said = summary(START, mission.problem, parameters, vehicles=vehicles, **told)
    return [*found, Item(f'{namespace}/plan_summary', START - SECOND, said)]


def _joint_states(
    topic: str, joints: Sequence[Joint], histories: Iterable[Signals | None]
) -> Iterator[Item]:
    """Yield the histories of those joints that they are of, on common instants."""
    known = [signals for signals in histories if signals is not None]
    columns = {name: signals.column(name) for signals in known for name in signals.names}
    joints = [j for j in joints if {j.position, j.velocity, j.effort} & set(columns)]
    if joints:
        rows = _rows(joints, columns)
        for k, at in enumerate(known[0].times):
            values = {quantity: rows[quantity][k] for quantity in QUANTITIES}
            message = joint_state(after(at), [joint.name for joint in joints], **values)
            yield Item(topic, after(at), message)


def _rows(joints: Sequence[Joint], columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return positions, velocities and efforts of joints, (n, joints); zero where not given."""
    nothing = np.zeros(len(next(iter(columns.values()))))
    return {
        quantity: np.stack([columns.get(getattr(j, quantity), nothing) for j in joints], axis=1)
        for quantity in QUANTITIES
    }


def pendulum_recording(namespace: str = '/pendulum') -> list[Item]:
    check = {
        'worst': {'torque': 0.006, 'disk_angle': 1.2},
        'worst_times': {'torque': 0.0, 'disk_angle': 2.0},
        'units': {'torque': 'N m', 'disk_angle': 'rad'},
        'terminal_error': {'theta': 1e-6},
    }
    return recorded(pendulum_mission(), namespace, verification=check)


def robot_recording(namespace: str = '/robots') -> list[Item]:
    worst = {'robot1.walls': 0.3, 'robot2.walls': 0.3, 'separation robot1-robot2': 0.6}
    return recorded(
        formation_mission(),
        namespace,
        cost_terms={'time': 0.5, 'sequence': 0.25, 'gas': 0.5},
        verification={'worst': worst, 'worst_times': dict.fromkeys(worst, 0.5)},
    )


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
    """Compare with the mission that was recorded."""
    expected = pendulum_mission()
    check_vehicles(mission, expected)
    (figures,) = mission.figures
    assert (figures.cost, figures.solve_time) == (1.25, 0.125)
    assert figures.margins['disk_angle'].instant == 2.0
    assert mission.vehicles[0].view.bounds() == expected.vehicles[0].view.bounds()
    assert mission.recorded_at == pytest.approx(START * 1e-9)


def check_vehicles(mission: Mission, expected: Mission) -> None:
    """Compare plans and everything measured with what was recorded."""
    for found, wanted in zip(mission.vehicles, expected.vehicles, strict=True):
        assert (found.name, found.view.name) == (wanted.name, wanted.view.name)
        (plan,), (planned,) = found.plans, wanted.plans
        assert (plan.start, plan.until) == (0.0, None)
        assert plan.trajectory.interpolation == planned.trajectory.interpolation
        np.testing.assert_allclose(plan.trajectory.times, planned.trajectory.times, atol=1e-9)
        np.testing.assert_array_equal(plan.trajectory.states, planned.trajectory.states)
        np.testing.assert_array_equal(plan.trajectory.controls, planned.trajectory.controls)
        for part in ('states', 'applied', 'commands', 'tracking_error'):
            one, other = getattr(found, part), getattr(wanted, part)
            assert (one is None) == (other is None), part
            if one is not None:
                assert one.names == other.names
                np.testing.assert_allclose(one.times, other.times, atol=1e-8)
                np.testing.assert_allclose(one.values, other.values, atol=1e-7)
