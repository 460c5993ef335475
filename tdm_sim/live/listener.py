# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The planner, its trackers and its plants as seen on their public topics and services.

Nodes are found by their diagnostics, published once a second. A callback for every state would
cost more than the page does, so the newest state is read when a frame is drawn.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
import math
import threading
import time
from typing import Any, NamedTuple
import uuid

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import Log, ParameterEvent
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import (
    DurabilityPolicy,
    qos_profile_parameter_events,
    QoSProfile,
    ReliabilityPolicy,
)
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tdm_planner.client import PlanClient
from tdm_planner.exceptions import InvalidProblem, NoAnswer
from tdm_planner.nodes.diagnostics import TOPIC as DIAGNOSTICS
from tdm_planner.nodes.messages import SERVICE
from tdm_planner.nodes.reading import nanoseconds_of, read_joints, read_odometry
from tdm_planner.plant_kind import PlantKind

Array = NDArray[np.float64]

SILENT = 3.0  # s without diagnostics after which a node counts as gone
PLANNING, TRACKING, SIMULATION = 'planning', 'tracking', 'simulation'  # of a node's diagnostics

_DEPTH = 100  # as many nodes may speak at once
_EVENTS = 200
_LOOK = 0.2  # s between looks at nodes whose parameters are not known
_AGAIN = 2.0  # s until they are asked again
_LONGEST = 20.0  # s for an answer
_LAST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_ROSOUT = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Event(NamedTuple):
    """Something that a node has logged; `level` as rcl_interfaces/msg/Log numbers it."""

    instant: float
    level: int
    node: str
    text: str


@dataclass
class NodeStatus:
    """A node's last diagnostics, and when they arrived on the steady clock [s]."""

    name: str
    role: str
    level: int = 0
    message: str = ''
    heard: float = -math.inf

    @property
    def silent(self) -> bool:
        """Whether its diagnostics have stopped."""
        return time.monotonic() - self.heard > SILENT

    @property
    def space(self) -> str:
        """Return its namespace."""
        return self.name.rpartition('/')[0]


@dataclass
class Declared:
    """Parameters of a node: what they are, and the values that they have."""

    descriptors: Mapping[str, Any] = field(default_factory=dict)
    values: dict[str, Any] = field(default_factory=dict)


class Motion(NamedTuple):
    """A vehicle's newest state (nx,), the controls (nu,) that act, and their instant [ns]."""

    state: Array
    control: Array
    instant: int


class Vehicle:
    """The state of one vehicle in the namespace `prefix`, taken when it is asked for."""

    def __init__(self, node: rclpy.node.Node, kind: PlantKind, prefix: str) -> None:
        self._kind = kind
        nothing = lambda _: None  # noqa: E731
        topic = f'{prefix}joint_states'
        self._joints = node.create_subscription(JointState, topic, nothing, _LAST)
        self._odometry = None
        if kind.odometry:
            self._odometry = node.create_subscription(Odometry, f'{prefix}odom', nothing, _LAST)
        self._values: dict[str, float] = dict.fromkeys(kind.control_names, 0.0)
        self._instant = 0

    def newest(self) -> Motion | None:
        """Return what is known of the motion; None until the state is complete."""
        kind = self._kind
        joints = _newest(self._joints)
        if joints is not None:
            self._take(lambda: read_joints(kind.measured, joints, kind.state_names), joints)
            for joint in kind.actuated:
                self._take(partial(read_joints, [joint], joints, kind.control_names), joints)
        odometry = None if self._odometry is None else _newest(self._odometry)
        if odometry is not None:
            self._take(lambda: read_odometry(kind, odometry), odometry)
        if any(name not in self._values for name in kind.state_names):
            return None
        return Motion(
            np.array([self._values[name] for name in kind.state_names]),
            np.array([self._values[name] for name in kind.control_names]),
            self._instant,
        )

    def _take(self, read: Callable[[], Mapping[str, float]], message: Any) -> None:
        try:
            self._values |= read()
        except InvalidProblem:
            return  # others may publish here; drivers may not tell of efforts
        self._instant = nanoseconds_of(message.header.stamp)


def _newest(subscription: Any) -> Any:
    """Take the last message that has come; None where there is no new one."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, False)
    return None if taken is None else taken[0]


class Listener:
    """
    Listens in a planner's namespace, and asks its nodes.

    `node` is to be served by another thread than the one that asks. Methods that ask wait for the
    answer; they raise `NoAnswer` where there is none.
    """

    def __init__(self, namespace: str, context: rclpy.Context | None = None) -> None:
        self.space = f'/{namespace.strip("/")}'.rstrip('/')
        number = uuid.uuid4().hex[:8]
        options: dict[str, Any] = {
            'context': context,
            'namespace': self.space or '/',
            'start_parameter_services': False,
            'enable_rosout': False,
        }
        self.node = rclpy.create_node(f'live_{number}', **options)
        # Not served by any executor: the states are taken from its subscriptions.
        self._states = rclpy.create_node(f'live_states_{number}', **options)
        self.client = PlanClient(self.space or '/', node=self.node)
        self.nodes: dict[str, NodeStatus] = {}
        self.declared: dict[str, Declared] = {}
        self.events: deque[Event] = deque(maxlen=_EVENTS)
        self.changes = 0  # of parameters
        self._clients: dict[tuple[str, type], Any] = {}
        self._asked: dict[str, float] = {}
        make = self.node.create_subscription
        make(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, _DEPTH)
        make(Log, '/rosout', self._on_log, _ROSOUT)
        make(ParameterEvent, '/parameter_events', self._on_event, qos_profile_parameter_events)
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.node.create_timer(_LOOK, self._look, clock=clock)

    def close(self) -> None:
        """Take the nodes away."""
        self.client.close()
        self._states.destroy_node()
        self.node.destroy_node()

    def vehicle(self, kind: PlantKind, prefix: str) -> Vehicle:
        """Begin to listen to the state of a vehicle, '' or 'robot1/'."""
        return Vehicle(self._states, kind, prefix)

    # Who is there.

    def having(self, role: str) -> list[NodeStatus]:
        """Return the nodes of a role, silent ones too, in the order of their names."""
        return [node for _, node in sorted(self.nodes.items()) if node.role == role]

    def parameters_of(self, role: str) -> Declared | None:
        """Return the parameters of the first node of a role, by which those of all are known."""
        first = next(iter(self.having(role)), None)
        return None if first is None else self.declared.get(first.name)

    def with_parameter(self, name: str) -> list[str]:
        """Return the nodes that have a parameter of that name."""
        found = []
        for role in (PLANNING, TRACKING, SIMULATION):
            declared = self.parameters_of(role)
            if declared is not None and name in declared.descriptors:
                found += [node.name for node in self.having(role) if not node.silent]
        return found

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            name, _, role = status.name.partition(': ')
            if not name.startswith(f'{self.space}/'):
                continue
            if role not in (PLANNING, TRACKING, SIMULATION):
                continue
            known = self.nodes.get(name)
            if known is None or known.silent:
                self.declared.pop(name, None)  # they may be others by now
            told = NodeStatus(name, role, status.level[0], status.message, now)
            self.nodes = {**self.nodes, name: told}  # read by other threads meanwhile

    def _on_log(self, message: Log) -> None:
        space = self.space.strip('/').replace('/', '.')
        if message.name.startswith(f'{space}.'.lstrip('.')):
            instant = nanoseconds_of(message.stamp) * 1e-9
            node = message.name.removeprefix(f'{space}.')
            self.events.append(Event(instant, message.level, node, message.msg))

    # Parameters.

    def _look(self) -> None:
        """Ask the first node of every role for its parameters, until they are known."""
        now = time.monotonic()
        for role in (PLANNING, TRACKING, SIMULATION):
            for node in self.having(role)[:1]:
                known = node.name in self.declared or node.silent
                if known or now - self._asked.get(node.name, -math.inf) < _AGAIN:
                    continue
                lists = self._client(ListParameters, f'{node.name}/list_parameters')
                if lists.service_is_ready():
                    self._asked[node.name] = now
                    asked = lists.call_async(ListParameters.Request())
                    asked.add_done_callback(partial(self._on_names, node.name))

    def _on_names(self, node: str, answer: Any) -> None:
        names = list(answer.result().result.names)
        describe = self._client(DescribeParameters, f'{node}/describe_parameters')
        asked = describe.call_async(DescribeParameters.Request(names=names))
        asked.add_done_callback(partial(self._on_described, node, names))

    def _on_described(self, node: str, names: Sequence[str], answer: Any) -> None:
        described = {found.name: found for found in answer.result().descriptors}
        values = self._client(GetParameters, f'{node}/get_parameters')
        asked = values.call_async(GetParameters.Request(names=list(names)))
        asked.add_done_callback(partial(self._on_values, node, names, described))

    def _on_values(
        self, node: str, names: Sequence[str], described: Mapping[str, Any], answer: Any
    ) -> None:
        values = map(parameter_value_to_python, answer.result().values)
        self.declared[node] = Declared(described, dict(zip(names, values, strict=True)))
        self.changes += 1

    def _on_event(self, message: ParameterEvent) -> None:
        declared = self.declared.get(message.node)
        if declared is None:
            return
        for item in (*message.new_parameters, *message.changed_parameters):
            declared.values[item.name] = parameter_value_to_python(item.value)
        for item in message.deleted_parameters:
            declared.values[item.name] = None
        self.changes += 1

    def set_parameters(self, nodes: Sequence[str], values: Mapping[str, Any]) -> None:
        """
        Set parameters of nodes.

        Raise InvalidProblem with the reason of the first node that rejects them.
        """
        messages = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=messages)
        asked = [self._ask(SetParameters, f'{node}/set_parameters', request) for node in nodes]
        for answer in asked:
            for result in answer().results:
                if not result.successful:
                    raise InvalidProblem(result.reason)

    def trigger(self, service: str) -> str:
        """Call a std_srvs/Trigger; returns its message."""
        return str(self._ask(Trigger, service, Trigger.Request())().message)

    def _client(self, kind: type, name: str) -> Any:
        found = self._clients.get((name, kind))
        if found is None:
            found = self.node.create_client(kind, name, qos_profile=SERVICE)
            self._clients[name, kind] = found
        return found

    def _ask(self, kind: Any, name: str, request: Any) -> Callable[[], Any]:
        """Send a request; what is returned waits for the answer."""
        client, done = self._client(kind, name), threading.Event()
        end = time.monotonic() + _LONGEST
        while not client.service_is_ready():
            if time.monotonic() > end:
                raise NoAnswer(f'no node serves {name}')
            time.sleep(0.01)
        asked = client.call_async(request)
        asked.add_done_callback(lambda _: done.set())

        def answer() -> Any:
            if not done.wait(_LONGEST):
                client.remove_pending_request(asked)
                raise NoAnswer(f'{name} did not answer within {_LONGEST:g} s')
            return asked.result()

        return answer
