# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Missions in closed form, as a reader returns them and as messages that the nodes would publish.

The pendulum's angles turn evenly and each robot goes straight on while it turns evenly, for
`DURATION` s. Of recordings some messages are left out, added or changed, a bag is written, and
what is read of it compared; the first plan's motion starts at `START`.
"""

import base64
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from html.parser import HTMLParser
import json
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tdm_planner.nodes import messages
from tdm_planner.plant_kind import PENDULUM, ROBOT
from tdm_planner.plant_views import PendulumView, RobotView
from tdm_planner.problems import PendulumSwingUp, RobotFormation
from tdm_planner.trajectory import SECOND, Trajectory
from tdm_sim.report import mission as parts
from tdm_sim.report.mission import FollowedPlan, Mission, RecordedVehicle
from tdm_sim.report.signals import Signals

DURATION = 2.0
PENDULUM_PARAMETERS = {'plant.arm_length': 0.1, 'plant.com_distance': 0.06}
PENDULUM_PARAMETERS |= {'limits.torque': 0.02, 'limits.disk_angle': 1.5}
ARENA_PARAMETERS = {'arena.length': 4.0, 'arena.width': 3.0, 'arena.minimum_separation': 0.4}
ARENA_PARAMETERS |= {'arena.obstacles': [2.0, 0.6, 0.25], 'limits.thrust': 1.0}
ARENA_PARAMETERS |= {'limits.torque': 0.02, 'limits.thruster_rate': 2.0}
EVIL = (  # strings that would do something if they could
    '</script><script>window.hacked=1</script>',
    '<img src=x onerror="window.hacked=2">',
    """'"><svg/onload=window.hacked=3>""",
    '<a href="javascript:window.hacked=4">x</a>{{data}}<!--',
)
# A single robot, so that its place fits into the arena.
ALONE = {'robots': ['robot1'], 'robot1.start.x': 0.5, 'robot1.start.y': 2.0}
ALONE |= {'formation.anchor': [0.0, 0.0, 0.0], 'formation.robot1': [1.0, 2.0, 0.0]}
START = 1_700_000_000_250_000_000  # ns
STORE = get_typestore(Stores.ROS2_JAZZY)


def pendulum_states(t: Any) -> Any:
    t = np.asarray(t, dtype=float)
    return np.stack([np.pi - 1.3 * t, 0.4 * t, 0 * t - 1.3, 0 * t + 0.4], axis=-1)


def robot_states(t: Any, number: int) -> Any:
    t = np.asarray(t, dtype=float)
    one = np.ones_like(t)
    ways = [0.5 + 0.6 * t, 0.5 + number + 0.2 * t, 0.6 * one, 0.2 * one]
    return np.stack([*ways, 0.3 * t, 0.3 * one, (0.5 + number) * one], axis=-1)


def robot_parameters(count: int) -> dict[str, Any]:
    names = [f'robot{k + 1}' for k in range(count)]
    values: dict[str, Any] = {'robots': names, 'formation.anchor': [0.0, 0.0, 0.0]}
    for k, name in enumerate(names):
        start, end = robot_states(np.array([0.0, DURATION]), k).tolist()
        values |= {f'{name}.start.x': start[0], f'{name}.start.y': start[1]}
        values[f'formation.{name}'] = [end[0], end[1], end[4]]
    return RobotFormation.from_parameters(values).to_parameters()


def pendulum_plan() -> Trajectory:
    times = np.linspace(0.0, DURATION, 41)
    controls = np.where(times < 0.8, 0.014, -0.014)[:, None]
    return Trajectory.of(PENDULUM, times, pendulum_states(times), controls)


def robot_plan(number: int) -> Trajectory:
    times = np.linspace(0.0, DURATION, 41)
    controls = np.tile([0.5, 0.125, 0.001], (times.size, 1))
    return Trajectory.of(ROBOT, times, robot_states(times, number), controls, 'linear')


def pendulum_mission(measured: bool = True, **changes: Any) -> Mission:
    plan = pendulum_plan()
    found: dict[str, Signals] = {}
    if measured:
        at = np.arange(-1.0, 4.0, 0.01)
        planned = plan.sample(np.clip(at, 0.0, DURATION))
        errors = np.tile([0.02, -0.01, 0.0, 0.0], (at.size, 1))
        states, applied = Signals.both(plan, at, planned._replace(state=planned.state + errors))
        found = {'states': states, 'commands': applied, 'applied': applied}
    view = PendulumView(problem=PendulumSwingUp.from_parameters(PENDULUM_PARAMETERS))
    events = (
        parts.Event(-0.5, parts.Level.OK, '/pendulum/planner', 'plan 1 active'),
        parts.Event(1.25, parts.Level.WARN, '/pendulum/tracker', 'late by 3 ms'),
    )
    vehicle = RecordedVehicle('pendulum', view, (FollowedPlan(plan, 0.0),), **found)
    figures = parts.PlanFigures(2.0, summary='upright after 2 s')
    more = {'events': events, 'parameters': PENDULUM_PARAMETERS}
    more |= {'source': '/bags/one', 'recorded_at': 1.7e9}
    plain = Mission('Swing-up', (vehicle,), (figures,), **more)
    return replace(plain, **changes)


def robots_mission(measured=True, rate=100.0, after=1.0, **changes: Any) -> Mission:
    """Return one of robots `names` in an arena `given` by parameters."""
    vehicles = []
    given = changes.pop('given', ARENA_PARAMETERS | ALONE)
    view = RobotView(problem=RobotFormation.from_parameters(given))
    for number, name in enumerate(changes.pop('names', ('robot1', 'robot2'))):
        plan = robot_plan(number)
        found: dict[str, Signals] = {}
        if measured:
            at = np.arange(0.0, DURATION + after, 1.0 / rate)
            planned = plan.sample(np.clip(at, 0.0, DURATION))
            off = planned._replace(state=planned.state + 0.01 * np.eye(7)[0])
            states, applied = Signals.both(plan, at, off)
            found = {'states': states, 'applied': applied}
        vehicles.append(RecordedVehicle(name, view, (FollowedPlan(plan, 0.0),), **found))
    plain = Mission('Formation', tuple(vehicles), parameters=ARENA_PARAMETERS)
    return replace(plain, **changes)


def formation_mission(**changes: Any) -> Mission:
    given = robot_parameters(2)
    return robots_mission(given=given, **({'parameters': given} | changes))


def replanned(mission: Mission, start: float, duration: float = DURATION) -> Mission:
    """With a second plan of every vehicle: the first one's, from `start` on and so long."""
    vehicles = []
    for vehicle in mission.vehicles:
        (first,) = vehicle.plans
        times = first.trajectory.times * duration / DURATION
        second = FollowedPlan(replace(first.trajectory, times=times), start)
        vehicles.append(replace(vehicle, plans=(replace(first, until=start), second)))
    return replace(mission, vehicles=tuple(vehicles))


def unpacked(data: dict[str, str]) -> Any:
    return np.frombuffer(base64.b64decode(data['bdata']), dtype='<f4')


class Parts(HTMLParser):
    """Elements of a page, its scripts with their attributes, other texts, and cells of tables."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.texts: list[str] = []
        self.rows: list[list[str]] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag == 'script':
            self.scripts.append((dict(attrs), ''))
        elif tag == 'tr':
            self.rows.append([])
        elif tag in ('td', 'th'):
            self.rows[-1].append('')

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == 'script':  # what HTMLParser is within
            attributes, text = self.scripts[-1]
            self.scripts[-1] = attributes, text + data
            return
        self.texts.append(data)
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data


class Item(NamedTuple):
    """A message to record under a topic at `stamp` [ns]; `data` replaces its bytes."""

    topic: str
    stamp: int
    message: Any
    data: bytes | None = None


def joint_state(at: int, names: Sequence[str], **values: Any) -> JointState:
    message = JointState(name=list(names), **values)
    message.header.stamp = messages.to_stamp(at)
    return message


def odometry(at: int, name: str, state: Sequence[float], frame: str = 'arena') -> Any:
    values = dict(zip(ROBOT.state_names, state, strict=False))
    exact = dict.fromkeys(values, 0.0)
    message = messages.odometry(ROBOT, values, exact, messages.to_stamp(at), name)
    message.header.frame_id = frame
    return message


def summary(at: int, problem: str, parameters: Any, **more: Any) -> String:
    stamp = {'sec': at // SECOND, 'nanosec': at % SECOND}
    document = {'plan_id': 1, 'stamp': stamp, 'problem': problem, 'parameters': parameters}
    document |= {'duration': DURATION, 'cost': 1.25, 'penalty': 0.0, 'solve_time': 0.125}
    document |= {'evaluations': 42, 'summary': 'a plan'}
    document |= {name: {} for name in ('cost_terms', 'verification', 'vehicles')}
    return String(data=json.dumps(document | more))


def status(at: int, node: str, level: int, message: str, **values: Any) -> DiagnosticArray:
    """Diagnostics of a node; of the names of values the underscores are spaces."""
    told = DiagnosticStatus(level=bytes([level]), name=f'{node}: x', hardware_id=node)
    told.message = message
    told.values = [KeyValue(key=k.replace('_', ' '), value=str(v)) for k, v in values.items()]
    array = DiagnosticArray(status=[told])
    array.header.stamp = messages.to_stamp(at)
    return array


def recorded(mission: Mission, namespace: str, **told: Any) -> list[Item]:
    """Return what nodes publish of a mission; `told` is in the plan's summary besides."""
    found, vehicles = [], {}
    for vehicle in mission.vehicles:
        kind, plan = vehicle.view.kind, vehicle.plans[0].trajectory
        space = f'{namespace}/{vehicle.name}' if kind.odometry else namespace
        vehicles[vehicle.name] = replace(kind, interpolation=plan.interpolation).to_dict()
        motion = messages.plan_message(kind, plan, messages.to_stamp(START))
        found.append(Item(f'{space}/trajectory', START - SECOND, motion))
        within = [joint for joint in kind.joints if joint.name not in kind.odometry]
        for name, joints, histories in (
            ('joint_states', within[::-1], (vehicle.states, vehicle.applied)),
            ('joint_command', kind.actuated, (vehicle.commands,)),
        ):
            for at, values in _moments(*histories):
                known = [j for j in joints if {j.position, j.velocity, j.effort} & set(values)]
                message = messages.joint_states(known, values)
                message.header.stamp = messages.to_stamp(at)
                found.append(Item(f'{space}/{name}', at, message))
        for at, values in _moments(vehicle.states if kind.odometry else Signals()):
            state = odometry(at, vehicle.name, list(values.values()))
            found.append(Item(f'{space}/odom', at, state))
    problem, parameters = mission.vehicles[0].view.problem, dict(mission.parameters)
    said = summary(START, problem.name, parameters, vehicles=vehicles, **told)
    return [*found, Item(f'{namespace}/plan_summary', START - SECOND, said)]


def _moments(*histories: Signals) -> Iterator[tuple[int, dict[str, float]]]:
    columns = {name: column for signals in histories for name, column in signals.columns.items()}
    for k, at in enumerate(histories[0].times):
        yield after(at), {name: float(column[k]) for name, column in columns.items()}


def pendulum_recording(namespace: str = '/pendulum') -> list[Item]:
    check = {'terminal_error': {'theta': 1e-6}}
    return recorded(pendulum_mission(), namespace, verification=check)


def robot_recording(namespace: str = '/robots') -> list[Item]:
    costs = {'time': 0.5, 'sequence': 0.25, 'gas': 0.5}
    return recorded(formation_mission(), namespace, cost_terms=costs)


def without(items: Iterable[Item], *endings: str) -> list[Item]:
    return [item for item in items if not item.topic.endswith(endings)]


def write(path: Path, items: Iterable[Item], storage: str = 'mcap', compression: str = '') -> Path:
    """Write a rosbag2; `compression` is '', message, file or storage (within MCAP)."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, at, message, data in sorted(items, key=lambda item: item.stamp):
            if topic not in connections:
                package, kind = type(message).__module__.split('.')[0], type(message).__name__
                name = f'{package}/msg/{kind}'
                connections[topic] = writer.add_connection(topic, name, typestore=STORE)
            writer.write(connections[topic], at, data or serialize_message(message))
    return path


def after(seconds: float) -> int:
    return START + round(seconds * 1e9)


def told(mission: Mission, sentence: str) -> bool:
    return any(sentence in text for text in mission.missing)


def check_pendulum(mission: Mission) -> None:
    expected = pendulum_mission()
    check_vehicles(mission, expected)
    (figures,) = mission.figures
    assert (figures.cost, figures.solve_time) == (1.25, 0.125)
    assert mission.vehicles[0].view.bounds == expected.vehicles[0].view.bounds
    assert mission.recorded_at == pytest.approx(START * 1e-9)


def check_vehicles(mission: Mission, expected: Mission) -> None:
    for found, wanted in zip(mission.vehicles, expected.vehicles, strict=True):
        assert (found.name, found.view.name) == (wanted.name, wanted.view.name)
        ((plan, start, until),) = ((p.trajectory, p.start, p.until) for p in found.plans)
        planned = wanted.plans[0].trajectory
        assert (start, until, plan.interpolation) == (0.0, None, planned.interpolation)
        np.testing.assert_allclose(plan.times, planned.times, atol=1e-9)
        np.testing.assert_array_equal(plan.states, planned.states)
        # the last controls are held for no time
        np.testing.assert_array_equal(plan.controls[:-1], planned.controls[:-1])
        for part in ('states', 'applied', 'commands'):
            one, other = getattr(found, part), getattr(wanted, part)
            assert [*one.columns] == [*other.columns], part
            if one:
                np.testing.assert_allclose(one.times, other.times, atol=1e-8)
                tables = one.table(one.columns), other.table(one.columns)
                np.testing.assert_allclose(*tables, atol=1e-7)
