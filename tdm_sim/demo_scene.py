# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""The scene of a demo: its nodes, their connections, and when the demo is over."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tdm_planner.nodes.diagnostics import TOPIC
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import seconds_of
from tdm_planner.nodes.tracker import tracker_specifications
from tdm_planner.parameter_files import read_parameters
from tdm_planner.parameters import ParameterSpec, specifications
from tdm_planner.plant_kind import QUANTITIES
from tdm_planner.plant_views import view_of
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import load_problem
from tdm_planner.problems.request import RequestParameters
from tdm_planner.resources import config_file
from tdm_planner.robot_nodes import robot_nodes
from tdm_planner.starting import NODES
from tdm_sim.plant_node import SimulationParameters
from tdm_sim.report.verdict import HOLD_TIME

NodeCommand = tuple[str, str, list[str]]

_AFTER = 0.5  # s that are waited beyond what the verdict needs


# How the parameters of planners, trackers and plants are declared, and which cover real time.
_DECLARED: Mapping[str, tuple[Callable[[], Mapping[str, ParameterSpec]], tuple[str, ...]]] = {
    'planner': (
        partial(specifications, RequestParameters),
        ('start.delay', 'start.max_age', 'replan.delay'),
    ),
    'tracker': (partial(tracker_specifications, 'pendulum'), ('state_timeout', 'replan.interval')),
    'plant': (partial(specifications, SimulationParameters), ('command_timeout',)),
}
_NODES = 100  # that may speak at once
_RATES = 2.0  # times more often than at real time the nodes of one plant may be called in a second


class Part(NamedTuple):
    """A node of a scene: executable, namespace, parameters beside those of the file."""

    executable: str
    namespace: str
    parameters: Mapping[str, Any] = {}


class Connections:
    """
    Which nodes are connected, from their own figures on `/diagnostics`.

    A process that sees two others does not know whether these see each other: the middleware may
    connect some pairs seconds after the rest.
    """

    def __init__(self) -> None:
        self._figures: dict[str, Mapping[str, str]] = {}

    def take(self, message: DiagnosticArray) -> None:
        """Keep the figures of a message."""
        for status in message.status:
            name = status.name.split(':', 1)[0]
            self._figures[name] = {value.key: value.value for value in status.values}

    def tracker(self, name: str) -> bool:
        """Whether a tracker receives states and sees a planner."""
        return math.isfinite(self._figure(name, 'state age [s]', math.inf)) and (
            self._figure(name, 'planners', 0.0) >= 1.0
        )

    def plant(self, name: str) -> bool:
        """Whether a plant receives commands."""
        return self._figure(name, 'commands accepted', 0.0) >= 1.0

    def _figure(self, name: str, key: str, default: float) -> float:
        try:
            return float(self._figures.get(name, {})[key])
        except (KeyError, ValueError):
            return default


class Scene:
    """
    Planner, trackers and plants in the planner's namespace and below it, seen from outside.

    `file` is the parameter file of all nodes; `parts` are the nodes, plants first. `now` is the
    instant [s] of the newest state, in the plants' time; -inf before the first.
    """

    def __init__(
        self,
        problem: Problem,
        namespace: str,
        parts: tuple[Part, ...],
        file: Path,
    ) -> None:
        self.problem, self.namespace, self.parts, self.file = problem, namespace, parts, file
        self.speed = 1.0  # of simulated time
        self.connections = Connections()
        self._view = view_of(problem)
        self.now = -math.inf
        self._plan: dict[str, Any] = {}
        self._errors: dict[str, dict[str, float]] = {}
        self._near_since: dict[str, float] = {}

    @property
    def plants(self) -> tuple[Part, ...]:
        """Return the nodes that simulate."""
        return tuple(part for part in self.parts if part.executable.endswith('plant'))

    def nodes(self) -> list[NodeCommand]:
        """Name, module and arguments of every node to start."""
        spaces = [plant.namespace for plant in self.plants]
        # what simulated time waits for: commands, and states of all plants
        followers = [f'{space}/joint_command' for space in spaces]
        followers += [f'{space}/joint_states' for space in spaces[1:]]
        commands = []
        for part in self.parts:
            arguments = ['--ros-args', '-r', f'__ns:={part.namespace}']
            arguments += ['--params-file', str(self.file)]
            settings = speed_settings(
                part.executable,
                self.file,
                self.speed,
                drives_clock=part == self.plants[0],
                rates=_RATES if len(self.plants) == 1 else 1.0,
                followers=followers,
                namespace=part.namespace,
            )
            for key, value in {**settings, **part.parameters}.items():
                told = value if isinstance(value, str) else json.dumps(value)
                arguments += ['-p', f'{key}:={told}']
            below = part.namespace.removeprefix(self.namespace).strip('/')
            name = f'{part.executable}_{below}' if below else part.executable
            commands.append((name, NODES[part.executable], arguments))
        return commands

    def listen(self, node: Node) -> None:
        """Subscribe to diagnostics, the plan, the first plant's state, every tracker's error."""
        node.create_subscription(DiagnosticArray, TOPIC, self.connections.take, _NODES)
        node.create_subscription(String, f'{self.namespace}/plan_summary', self._on_plan, LATCHED)
        first = f'{self.plants[0].namespace}/joint_states'  # all plants have one clock
        node.create_subscription(JointState, first, self._on_state, qos_profile_sensor_data)
        for plant in self.plants:
            node.create_subscription(
                JointState,
                f'{plant.namespace}/tracking_error',
                partial(self._on_error, plant.namespace),
                qos_profile_sensor_data,
            )

    def _on_plan(self, message: String) -> None:
        self._plan = json.loads(message.data)

    def _on_state(self, message: JointState) -> None:
        self.now = seconds_of(message.header.stamp)

    def _on_error(self, space: str, message: JointState) -> None:
        kind, names = self._view.kind, list(message.name)
        found = {
            getattr(joint, quantity): float(getattr(message, quantity)[names.index(joint.name)])
            for joint in kind.joints
            if joint.name in names
            for quantity in QUANTITIES[:2]
            if getattr(joint, quantity) in kind.state_names and len(getattr(message, quantity))
        }
        self._errors[space] = found
        at = seconds_of(message.header.stamp)
        near = all(
            math.hypot(*(found.get(name, math.inf) for name in names)) < allowed
            for names, allowed in self._view.near
        )
        before = self._near_since.get(space, math.inf)
        self._near_since[space] = min(before, at) if near else math.inf

    def missing(self, client: Client) -> list[str]:
        """
        Name the nodes that are not up or not connected; `client` is of the planner's service.

        A plan requested earlier might reach a node after its motion is over.
        """
        found = []
        for part in self.parts:
            name = f'{part.namespace}/{part.executable}'
            if part.executable == 'tracker':
                up = self.connections.tracker(name)
            elif part in self.plants:
                up = self.connections.plant(name)
            else:
                up = client.service_is_ready()
            found += [] if up else [name]
        return found

    @property
    def planned(self) -> bool:
        """Whether the plan has been received."""
        return bool(self._plan)

    @property
    def _start(self) -> float:
        stamp = self._plan['stamp']
        return float(stamp['sec'] + 1e-9 * stamp['nanosec'])

    def goes_on_from(self, instant: float) -> bool:
        """Whether a state newer than of the instant [s] was heard, or the demo is over."""
        return self.over or self.now > instant

    @property
    def over(self) -> bool:
        """Whether the goal has been held long enough, or it is too late for it."""
        if not self._plan:
            return False
        end = self._start + float(self._plan['duration'])
        if self.now > end + self._view.settling + HOLD_TIME + _AFTER:
            return True
        if not self._view.near or len(self._near_since) < len(self.plants):
            return False
        return self.now - max(end, *self._near_since.values()) > HOLD_TIME + _AFTER

    def status(self) -> str:
        """Return the live line: time, and how far the plants are from their plans."""
        if not math.isfinite(self.now):
            return 'waiting for the plants'
        parts = []
        if self._plan:
            since, length = self.now - self._start, float(self._plan['duration'])
            parts.append(f't = {since:+6.2f} s of {length:.2f} s, off the plan by')
            several = len(self._errors) > 1
            for space, errors in self._errors.items():
                shown = ' '.join(f'{name} {value:+.3f}' for name, value in errors.items())
                worst = max(map(abs, errors.values()), default=0.0)
                parts.append(f'{space.rsplit("/", 1)[-1]} {worst:.3f}' if several else shown)
        return '   '.join(parts)


def make_scene(plant: str, parameters: Path | None, output: Path) -> Scene:
    """
    Return the scene of a built-in plant, or of a stated problem by its name.

    Raises
    ------
    InvalidProblem
        If there is no such problem, or the parameter file cannot be used.

    """
    built_in = _BUILT_IN.get(plant)
    kind = load_problem(built_in[0] if built_in else plant)
    space = f'/{plant if built_in else kind.name}'
    if built_in:
        file = config_file(f'{plant}.yaml') if parameters is None else parameters
        values = read_parameters(file, namespace=space)
        parts = built_in[1](space, values)
    else:
        file = output / 'parameters.yaml' if parameters is None else parameters
        values = read_parameters(file, node='planner', required=False) if parameters else {}
        named = ('plant', 'problem'), ('tracker', 'kind'), ('planner', 'problem')
        parts = [Part(node, space, {parameter: plant}) for node, parameter in named]
    return Scene(kind.from_parameters(values), space, tuple(parts), file.resolve())


def _pendulum_parts(space: str, values: Mapping[str, Any]) -> list[Part]:
    del values
    return [Part(name, space) for name in ('pendulum_plant', 'tracker', 'planner')]


def _robots_parts(space: str, values: Mapping[str, Any]) -> list[Part]:
    planner, *others = robot_nodes({'/**/planner': {'ros__parameters': values}})
    return [
        Part(node.executable, f'{space}/{node.robot}'.rstrip('/'), node.parameters)
        for node in (*others, planner)
    ]


# Plants of this package: the problem, and the nodes for a namespace and the planner's parameters.
_BUILT_IN: Mapping[str, tuple[str, Callable[[str, Mapping[str, Any]], list[Part]]]] = {
    'pendulum': ('pendulum_swing_up', _pendulum_parts),
    'robots': ('robot_formation', _robots_parts),
}


def speed_settings(
    executable: str,
    file: Path,
    speed: float,
    drives_clock: bool,
    rates: float = 1.0,
    followers: Sequence[str] = ('joint_command',),
    namespace: str | None = None,
) -> dict[str, Any]:
    """
    Return a node's parameters beside the parameter file, for a demo at `speed` times real time.

    One plant drives `/clock`, all others follow it. Solving and messages take real time: at a
    higher speed, delays and timeouts that cover them are longer in simulated time. Rates are
    lowered to what the computer can serve.

    `rates` is how many times more often than at real time the nodes may be called in a second;
    `followers` are the topics whose publishers the clock waits for. Of the parameter file those
    sections count that are for the node in `namespace`; None: in any.
    """
    if speed == 1.0:
        return {}
    declare, cover_real_time = _DECLARED[executable.rpartition('_')[2]]
    declared = declare()
    given = read_parameters(file, node=executable, namespace=namespace, required=False)
    settings: dict[str, Any] = {'use_sim_time': not drives_clock}
    if drives_clock:
        settings |= {'publish_clock': True, 'real_time_factor': speed}
        settings['clock_followers'] = list(followers)
    for name in cover_real_time:
        spec = declared[name]
        value = float(given.get(name, spec.default)) * max(speed, 1.0)
        settings[name] = min(value, spec.range.upper)
    if 'rate' in declared:
        rate = float(given.get('rate', declared['rate'].default))
        settings['rate'] = rate * min(rates / speed, 1.0)
    return settings
