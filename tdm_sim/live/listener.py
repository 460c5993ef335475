# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The planner, its trackers and its plants as seen on their public topics and services.

Nodes are found by their diagnostics, published once a second.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from functools import cache, partial
import time
from typing import Any, NamedTuple
import uuid

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log, ParameterEvent
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.client import Client
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, qos_profile_parameter_events, QoSProfile
from std_srvs.srv import Trigger
from tdm_planner.client import PlanClient
from tdm_planner.exceptions import InvalidProblem, NoAnswer
from tdm_planner.nodes.diagnostics import TOPIC as DIAGNOSTICS
from tdm_planner.nodes.messages import SERVICE
from tdm_planner.nodes.reading import nanoseconds_of

SILENT = 3.0  # s without diagnostics after which a node counts as gone
ROLES = PLANNING, TRACKING, SIMULATION = 'planning', 'tracking', 'simulation'  # in diagnostics

_DEPTH = 100  # as many nodes may speak at once
_EVENTS = 200
_LONGEST = 20.0  # s for an answer
# What a node has logged: its instant [s], its level as in rcl_interfaces/msg/Log, node and text.
Event = tuple[float, int, str, str]
_ROSOUT = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class NodeStatus(NamedTuple):
    """A node's last diagnostics, and when they arrived on the steady clock [s]."""

    name: str
    role: str
    level: int
    message: str
    heard: float

    @property
    def silent(self) -> bool:
        """Whether its diagnostics have stopped."""
        return time.monotonic() - self.heard > SILENT

    @property
    def space(self) -> str:
        """Return its namespace."""
        return self.name.rpartition('/')[0]


class Declared(NamedTuple):
    """Parameters of a node: what they are, and the values that they have."""

    descriptors: Mapping[str, Any]
    values: dict[str, Any]


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
        # Not served by any executor: states are taken from its subscriptions.
        self.states = rclpy.create_node(f'live_states_{number}', **options)
        self.client = PlanClient(self.space or '/', node=self.node)
        self.nodes: dict[str, NodeStatus] = {}
        self.declared: dict[str, Declared] = {}
        self.events: deque[Event] = deque(maxlen=_EVENTS)
        self.changes = 0  # of parameters
        # Clients of a node's parameters, by its name, and of a service by type and name.
        self._parameters = cache(lambda node: AsyncParameterClient(self.node, node, SERVICE))
        self._client = cache(partial(self.node.create_client, qos_profile=SERVICE))
        make = self.node.create_subscription
        make(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, _DEPTH)
        make(Log, '/rosout', self._on_log, _ROSOUT)
        make(ParameterEvent, '/parameter_events', self._on_event, qos_profile_parameter_events)

    def close(self) -> None:
        """Take the nodes away."""
        self.client.close()
        self.states.destroy_node()
        self.node.destroy_node()

    def having(self, role: str) -> list[NodeStatus]:
        """Return the nodes of a role, silent ones too, in the order of their names."""
        return [node for _, node in sorted(self.nodes.items()) if node.role == role]

    def parameters_of(self, role: str) -> Declared:
        """Return a role's parameters, those of its first node; empty while they are not known."""
        first = next((node.name for node in self.having(role)), '')
        return self.declared.get(first, Declared({}, {}))

    def with_parameter(self, name: str) -> list[str]:
        """Return the nodes that have a parameter of that name."""
        roles = [role for role in ROLES if name in self.parameters_of(role).descriptors]
        nodes = [node for role in roles for node in self.having(role)]
        return [node.name for node in nodes if not node.silent]

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            name, _, role = status.name.partition(': ')
            other = role == PLANNING and name.rpartition('/')[0] != self.space
            if not name.startswith(f'{self.space}/') or role not in ROLES or other:
                continue
            known = self.nodes.get(name)
            if known is None or known.silent:
                self.declared.pop(name, None)  # they may be others by now
            told = NodeStatus(name, role, status.level[0], status.message, now)
            self.nodes = {**self.nodes, name: told}  # read by other threads meanwhile
            if name not in self.declared and name == self.having(role)[0].name:
                self._learn(name)

    def _on_log(self, message: Log) -> None:
        space = f'{self.space}/'.replace('/', '.').lstrip('.')
        if message.name.startswith(space):
            instant, node = nanoseconds_of(message.stamp) * 1e-9, message.name.removeprefix(space)
            self.events.append((instant, message.level, node, message.msg))

    # Parameters.

    def _learn(self, node: str) -> None:
        """Ask a node for its parameters once its services are known."""
        client = self._parameters(node)

        def on_names(answer: Any) -> None:
            client.describe_parameters(answer.result().result.names, on_described)

        def on_described(answer: Any) -> None:
            descriptors = {found.name: found for found in answer.result().descriptors}
            client.get_parameters(list(descriptors), partial(on_values, descriptors))

        def on_values(descriptors: Mapping[str, Any], answer: Any) -> None:
            values = map(parameter_value_to_python, answer.result().values)
            known = Declared(descriptors, dict(zip(descriptors, values, strict=True)))
            if node not in self.declared:  # asked twice, it may be older than an event since
                self.declared[node] = known
                self.changes += 1

        if client.services_are_ready():
            client.list_parameters(callback=on_names)

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
        """Set parameters of nodes in turn; raise InvalidProblem with the first one's reason."""
        given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParameters.Request(parameters=given)
        for client in [self._client(SetParameters, f'{node}/set_parameters') for node in nodes]:
            for result in _answer(client, request).results:
                if not result.successful:
                    raise InvalidProblem(result.reason)

    def trigger(self, service: str) -> str:
        """Call a std_srvs/Trigger; returns its message."""
        return str(_answer(self._client(Trigger, service), Trigger.Request()).message)


def _answer(client: Client, request: Any) -> Any:
    """Return the answer to a request, while another thread serves the node; NoAnswer if none."""
    answer = client.call(request, _LONGEST) if client.wait_for_service(_LONGEST) else None
    if answer is None:
        raise NoAnswer(f'{client.service_name} did not answer within {_LONGEST:g} s')
    return answer
