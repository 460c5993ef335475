# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes as processes: started, watched and ended together; the scene of a plant's nodes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
import json
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.logging import get_logger, LoggingSeverity
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tdm_planner.exceptions import InvalidProblem, one_line, TdmError
from tdm_planner.nodes.diagnostics import TOPIC
from tdm_planner.nodes.messages import LATCHED
from tdm_planner.nodes.reading import nanoseconds_of, seconds_of
from tdm_planner.nodes.tracker_plans import TOPIC as STATUSES
from tdm_planner.parameter_files import config_file, read_parameters
from tdm_planner.parameters import specifications
from tdm_planner.plant_views import view_of
from tdm_planner.problems.planner_parameters import PlannerParameters
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import check_file_is_for, load_problem, SHORT_NAMES
from tdm_planner.robot_nodes import Part, robot_nodes
from tdm_planner.starting import NODES, PARENT, uninterrupted
from tdm_planner.tracking.motion import TrackerParameters
from tdm_planner.trajectory import NANOSECOND
from tdm_sim.plant_node import SimulationParameters
from tdm_sim.report.untrusted import read_summary
from tdm_sim.report.verdict import HOLD_TIME

_DISCOVERY, _POLL_PERIOD = 1.5, 0.05  # s for which nodes are looked for, and between looks
_GRACE = 30.0  # seconds a process gets to end on SIGINT before it is killed
_AFTER = 0.5  # s that are waited beyond what the verdict needs
_NODES = 100  # that may speak at once
_DECLARED = {'planner': PlannerParameters, 'tracker': TrackerParameters}  # others are plants
_RATES = 2.0  # times more often than at real time the nodes of one plant may be called in a second
_WRITE_INSTEAD = {  # by what rcl says of a parameter file
    'ros__parameters': "; parameters must stand below the name of a node, '/**' for all nodes, "
    "and below it 'ros__parameters'",
    'same type': '; the numbers of a list must all have a decimal point, or none of them',
}
# Times that a busy computer takes: as many real seconds where simulated time runs faster.
_COVER_REAL_TIME = frozenset({
    'start.delay', 'start.max_age', 'replan.delay', 'state_timeout', 'replan.interval',
    'command_timeout',
})  # fmt: skip


class ProcessFailed(TdmError):
    """A process ended unexpectedly, or does not do what it was started for."""

    code = 'PROCESS_FAILED'


class NodeProcesses:
    """
    Python modules run as processes, each in a group of its own, output to ``FOLDER/NAME.log``.

    As a context manager it ends everything on leaving, in the reverse order of starting. On Linux
    a process also ends with the thread that started it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, module: str, arguments: Sequence[str]) -> None:
        """Run ``python -m MODULE ARGUMENTS`` under a name."""
        self.folder.mkdir(parents=True, exist_ok=True)
        mode = 'ab' if name in self._processes else 'wb'  # why it ended before is in the log
        # A signal between start and registration would leave the process running.
        with self._log(name).open(mode) as output, uninterrupted():
            self._processes[name] = subprocess.Popen(
                [sys.executable, '-m', module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, PARENT: str(os.getpid())},
            )

    @property
    def identifiers(self) -> dict[str, int]:
        """Process identifier by name."""
        return {name: process.pid for name, process in self._processes.items()}

    def check(self) -> None:
        """Raise ProcessFailed, with exit code and last line, if a process has ended by itself."""
        for name, code in self.ended().items():
            raise ProcessFailed(f'{name} ended with exit code {code}: {self.last_line(name)}')

    def ended(self) -> dict[str, int]:
        """Return the exit codes of the processes that have ended by themselves, by name."""
        codes = {name: process.poll() for name, process in self._processes.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def last_line(self, name: str) -> str:
        """Return the last line a process printed, and where its log is."""
        lines = self.printed(name).strip().splitlines()
        return f'{lines[-1] if lines else "it printed nothing"} (see {self._log(name)})'

    def printed(self, name: str) -> str:
        """Return all that a process has printed."""
        return self._log(name).read_text(errors='replace')

    def end(self) -> dict[str, int]:
        """Interrupt every process, wait, and return the exit codes by name."""
        codes: dict[str, int] = {}
        for process in reversed(self._processes.values()):
            _signal_group(process, signal.SIGINT)
        deadline = time.monotonic() + _GRACE
        for name, process in self._processes.items():
            try:
                codes[name] = process.wait(max(deadline - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                _signal_group(process, signal.SIGKILL)
                codes[name] = process.wait()
        self._processes.clear()
        return codes

    def _log(self, name: str) -> Path:
        return self.folder / f'{name}.log'

    def __enter__(self) -> NodeProcesses:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    if process.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)


def nodes_run(namespace: str) -> bool:
    """Whether nodes run in a namespace or below it."""
    with Context() as context:
        node = rclpy.create_node('look', context=context, start_parameter_services=False)
        try:
            end = time.monotonic() + _DISCOVERY
            while time.monotonic() < end:
                spaces = [f'{space}/' for _, space in node.get_node_names_and_namespaces()]
                if any(space.startswith(f'{namespace}/') for space in spaces):
                    return True
                time.sleep(_POLL_PERIOD)
        finally:
            node.destroy_node()
    return False


class Scene:
    """
    Planner, trackers and plants in the planner's namespace and below it, seen from outside.

    `file` is the parameter file of all nodes, if any; `parts` are the nodes, a plant before its
    tracker. `now` is the instant [s] of the newest state, in the plants' time; -inf before the
    first. `heard_at` is the monotonic time at which it, or the plan, was heard. `clients` are of
    the planner's service `plan` and the plants' `reset`, by the nodes' names.
    """

    def __init__(
        self, problem: Problem, namespace: str, parts: Sequence[Part], file: Path | None
    ) -> None:
        self.problem, self.namespace, self.file = problem, namespace, file
        self.parts = [
            part._replace(namespace=f'{namespace}/{part.namespace}'.rstrip('/')) for part in parts
        ]
        self.speed = 1.0  # of simulated time
        self.plants = [part for part in self.parts if part.executable.endswith('plant')]
        self.now, self.heard_at = -math.inf, -math.inf
        self.clients: dict[str, Client] = {}
        self._view = view_of(problem)
        self._view.check_drawing()
        self._start: int | None = None  # of the plan [ns]
        self._duration = 0.0  # of the plan [s]
        self._figures: dict[str, dict[str, str]] = {}  # by node
        # When a tracker said that the goal of a plan is reached [s], by its namespace and plan.
        self._reached: dict[tuple[str, int], float] = {}

    def nodes(self) -> list[tuple[str, str, list[str]]]:
        """Name, module and arguments of every node to start."""
        spaces = [plant.namespace for plant in self.plants]
        # what simulated time waits for: commands, and states of all plants
        followers = [f'{space}/joint_command' for space in spaces]
        followers += [f'{space}/joint_states' for space in spaces[1:]]
        rates = _RATES if len(spaces) == 1 else 1.0
        commands = []
        for part in self.parts:
            arguments = ['--ros-args', '-r', f'__ns:={part.namespace}']
            arguments += ['--params-file', str(self.file)] if self.file else []
            waits_for = followers if part == self.plants[0] else ()
            settings = speed_settings(part, self.file, self.speed, waits_for, rates)
            for key, value in {**settings, **part.parameters}.items():
                told = value if isinstance(value, str) else json.dumps(value)
                arguments += ['-p', f'{key}:={told}']
            below = part.namespace.removeprefix(self.namespace).strip('/')
            name = f'{part.executable}_{below}' if below else part.executable
            commands.append((name, NODES[part.executable], arguments))
        return commands

    def listen(self, node: Node) -> None:
        """Subscribe to diagnostics, plan, statuses and the first plant's state; make clients."""
        node.create_subscription(DiagnosticArray, TOPIC, self.take_diagnostics, _NODES)
        node.create_subscription(String, f'{self.namespace}/plan_summary', self._on_plan, LATCHED)
        first = f'{self.plants[0].namespace}/joint_states'  # all have one clock
        node.create_subscription(JointState, first, self._on_state, qos_profile_sensor_data)
        for plant in self.plants:
            told, space = partial(self._on_statuses, plant.namespace), plant.namespace
            node.create_subscription(GoalStatusArray, f'{space}/{STATUSES}', told, LATCHED)
            self.clients[plant.name] = node.create_client(Trigger, f'{space}/reset')
        plan = node.create_client(Trigger, f'{self.namespace}/plan')
        self.clients[f'{self.namespace}/planner'] = plan

    def take_diagnostics(self, message: DiagnosticArray) -> None:
        """Keep the figures of nodes."""
        for status in message.status:
            name = status.name.split(':', 1)[0]
            self._figures[name] = {value.key: value.value for value in status.values}

    def _on_plan(self, message: String) -> None:
        self._start, figures = read_summary(message.data)
        self._duration, self.heard_at = float(figures.document['duration']), time.monotonic()

    def _on_statuses(self, space: str, message: GoalStatusArray) -> None:
        for status in message.status_list:
            if status.status == GoalStatus.STATUS_SUCCEEDED:
                plan = nanoseconds_of(status.goal_info.stamp)
                self._reached.setdefault((space, plan), self.now)

    def _on_state(self, message: JointState) -> None:
        now = seconds_of(message.header.stamp)
        if now > self.now:  # a clock that stands still is silence
            self.now, self.heard_at = now, time.monotonic()

    def missing(self) -> list[str]:
        """
        Name the nodes that are not up or not connected.

        A plan requested earlier might reach a node after its motion is over. Whether others see
        each other is in their own figures: the middleware may connect some pairs seconds later.
        """
        return [part.name for part in self.parts if not self._up(part)]

    def _up(self, part: Part) -> bool:
        """Whether services are there, plants get commands, trackers states, and see a planner."""
        figures, client = self._figures.get(part.name, {}), self.clients.get(part.name)
        if client is not None and not client.service_is_ready():
            return False
        if part in self.plants:
            return figures.get('commands accepted', '0') != '0'
        if part.executable == 'planner':
            return True
        return figures.get('planners', '0') != '0' and figures.get('state age [s]', 'inf') != 'inf'

    @property
    def planned(self) -> bool:
        """Whether the plan has been received."""
        return self._start is not None

    @property
    def over(self) -> bool:
        """Whether there was time to reach the goal and to hold it."""
        if self._start is None:
            return False
        start, duration = self._start * NANOSECOND, self._duration
        latest = duration + self._view.settling(duration)
        reached = [self._reached.get((p.namespace, self._start), math.inf) for p in self.plants]
        since = max(duration, max(reached) - start)
        return self.now - start > min(latest, since) + HOLD_TIME + _AFTER

    def status(self) -> str:
        """Return the live line."""
        if not math.isfinite(self.now):
            return 'waiting for the plants'
        if self._start is None:
            return ''
        return f't = {self.now - self._start * NANOSECOND:+6.2f} s of {self._duration:.2f} s'


def make_scene(plant: str, parameters: Path | None = None) -> Scene:
    """
    Return the scene of a built-in plant, or of a stated problem by its name.

    Raise InvalidProblem if there is no such problem, or the parameter file cannot be used.
    """
    built_in = plant in SHORT_NAMES
    kind = load_problem(SHORT_NAMES.get(plant, plant))
    space = f'/{plant if built_in else kind.name}'
    file = parameters or (config_file(f'{plant}.yaml') if built_in else None)
    alone = () if built_in else ('tracker', 'plant')  # that a file may be for
    theirs = [read_parameters(file, (), node, space, required=False) for node in alone]
    values = read_parameters(file, namespace=space, required=not any(theirs))
    check_file_is_for(SHORT_NAMES.get(plant, plant), values, file)
    if plant == 'robots':
        planner, *others = robot_nodes(values)
        parts = [*others, planner]
    elif built_in:
        parts = [Part(name) for name in (f'{plant}_plant', 'tracker', 'planner')]
    else:
        parts = [
            Part('plant', '', {'problem': plant, 'held': True}),  # until there is a plan
            Part('tracker', '', {'kind': plant}),
            Part('planner', '', {'problem': plant}),
        ]
    problem = kind.from_parameters(values)
    if parameters is not None:
        _check_for_nodes(parameters)
    return Scene(problem, space, parts, file and file.resolve())


def _check_for_nodes(file: Path) -> None:
    """Raise InvalidProblem for a parameter file that rcl, which nodes read it with, rejects."""
    context, log = Context(), get_logger('rcl')
    log.set_level(LoggingSeverity.FATAL)  # it logs the same, without what to write instead
    try:
        context.init(['--ros-args', '--params-file', str(file)], initialize_logging=False)
    except RuntimeError as error:  # RCLError is of a private module
        why = one_line(error).rpartition('Error: ')[2].partition(', at /')[0]
        hint = next((hint for part, hint in _WRITE_INSTEAD.items() if part in why), '')
        raise InvalidProblem(f"nodes cannot read the file '{file}': {why}{hint}") from None
    else:
        context.shutdown()
    finally:
        log.set_level(LoggingSeverity.UNSET)


def speed_settings(
    part: Part,
    file: Path | None,
    speed: float,
    followers: Sequence[str] = (),
    rates: float = 1.0,
) -> dict[str, Any]:
    """
    Return a node's parameters beside the parameter file, for a demo at `speed` times real time.

    The plant with `followers`, topics whose publishers it waits for, drives `/clock`. Solving and
    messages take real time. Above real-time speed the parameters of `_COVER_REAL_TIME` are
    multiplied by `speed` therefore, and the node's rate by `rates` / `speed` (1 at most).
    """
    if speed == 1.0:
        return {}
    declared = specifications(_DECLARED.get(part.executable, SimulationParameters))
    given = read_parameters(file, node=part.executable, namespace=part.namespace, required=False)
    settings: dict[str, Any] = {'use_sim_time': True}
    if followers:
        settings = {'use_sim_time': False, 'publish_clock': True, 'real_time_factor': speed}
        settings['clock_followers'] = list(followers)
    for name in declared.keys() & _COVER_REAL_TIME:
        value = float(given.get(name, declared[name].default)) * max(speed, 1.0)
        settings[name] = min(value, declared[name].range.upper)
    if 'rate' in declared:
        rate = float(given.get('rate', declared['rate'].default))
        settings['rate'] = rate * min(rates / speed, 1.0)
    return settings
