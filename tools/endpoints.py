# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the nodes offer over ROS, asked of the nodes themselves: they are made, not run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
import os
import re
from typing import Any
from unittest.mock import patch

import rclpy
from rclpy.qos import DurabilityPolicy
from tdm_planner.nodes.planner import Planner
from tdm_planner.nodes.tracker import TrackerNode
from tdm_sim.pendulum_plant import PendulumPlant
from tdm_sim.robot_plant import RobotPlant

OF_EVERY_NODE = re.compile(
    r'/(rosout|parameter_events|get_type_description)$'
    r'|/(describe|get|list|set)_parameter(s|_types)(_atomically)?$'
    r'|/(change_state|get_state|get_available_(states|transitions)|get_transition_graph)$'
    r'|/transition_event$'
)
KINDS = ('service', 'subscribes', 'calls', 'publishes')


@dataclass(frozen=True, order=True)
class Endpoint:
    """A topic or service: `kind` is one of `KINDS`, `type_name` without its middle part."""

    name: str
    kind: str
    type_name: str
    latched: bool = False


@dataclass(frozen=True)
class NodeSetUp:
    """How to make a node so that all its topics are there."""

    make: Callable[[], Any]
    namespace: str
    parameters: Mapping[str, str]


_ROBOTS = {'problem': 'robot_formation', 'replan.rate': '1.0'}
SET_UPS: Mapping[str, NodeSetUp] = {
    'planner pendulum': NodeSetUp(Planner, '/pendulum', {'replan.rate': '1.0'}),
    'planner robots': NodeSetUp(Planner, '/robots', _ROBOTS),
    'tracker pendulum': NodeSetUp(TrackerNode, '/pendulum', {}),
    'tracker robot': NodeSetUp(TrackerNode, '/robots/robot1', {'kind': 'robot'}),
    'pendulum_plant': NodeSetUp(PendulumPlant, '/pendulum', {'publish_clock': 'true'}),
    'robot_plant': NodeSetUp(RobotPlant, '/robots/robot1', {'publish_clock': 'true'}),
}


@cache
def endpoints(name: str) -> tuple[Endpoint, ...]:
    """Return the topics and services of one of `SET_UPS`, sorted, without those of every node."""
    with running(SET_UPS[name]) as node:
        found = {
            replace(end, name=_relative(end.name, node))
            for end in used_by(node)
            if not OF_EVERY_NODE.search(end.name)
        }
    return tuple(sorted(found))


@contextmanager
def running(set_up: NodeSetUp) -> Iterator[Any]:
    """Make a node that no other process can see, and that logs nothing."""
    arguments = ['--ros-args', '-r', f'__ns:={set_up.namespace}']
    for parameter, value in set_up.parameters.items():
        arguments += ['-p', f'{parameter}:={value}']
    arguments += ['--disable-stdout-logs', '--disable-external-lib-logs']
    with patch.dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE='OFF'):
        rclpy.init(args=arguments)
        try:
            node = set_up.make()
            try:
                yield node
            finally:
                node.destroy_node()
        finally:
            rclpy.try_shutdown()


def used_by(node: Any) -> Iterator[Endpoint]:
    """Yield every endpoint of a node by its absolute name."""
    for publisher in node.publishers:
        latched = publisher.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        yield Endpoint(publisher.topic_name, 'publishes', _type(publisher.msg_type), latched)
    for subscription in node.subscriptions:
        yield Endpoint(subscription.topic_name, 'subscribes', _type(subscription.msg_type))
    for service in node.services:
        yield Endpoint(service.service_name, 'service', _type(service.srv_type))
    for client in node.clients:
        yield Endpoint(client.service_name, 'calls', _type(client.srv_type))


def _type(kind: type) -> str:
    """Return the name of a message or service type without its middle part."""
    return f'{kind.__module__.split(".")[0]}/{kind.__name__}'


def _relative(topic: str, node: Any) -> str:
    """Return a name as people write it: relative, one robot standing for all."""
    name = topic.removeprefix(f'{node.get_namespace()}/')
    name = re.sub(r'^robot\d+/', '<robot>/', name)
    return name.removeprefix('/robots/')  # the planner's, above a robot's
