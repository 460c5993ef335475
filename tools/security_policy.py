# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
The SROS2 policy: what every node may publish, subscribe, serve and call, and nothing else.

The names are asked of the nodes themselves, made in the namespaces of the launch files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element, indent, SubElement, tostring

from tdm_planner.nodes.lifecycle import ManagedNode
from tdm_planner.problems.formation.parameters import DEFAULT_ROBOTS
from tools.endpoints import NodeSetUp, running, SET_UPS, used_by

OPERATOR = '/operator'
_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<!-- Copyright 2026 The tdm_planner authors -->
<!-- SPDX-License-Identifier: Apache-2.0 -->
<!-- SROS2 policy: every node has only its own topics and services. The enclave {operator} is for
     people and their tools: requests, parameters, goals, and everything to be looked at.
     Written by `make config` from the nodes; docs/security.md says how it is used. -->
"""
# What people's tools publish: goals, by the end of their names, and what every node does.
_GOALS = '/goal_pose'
_OF_EVERY_NODE = ('/rosout', '/parameter_events')


@dataclass(frozen=True)
class Rights:
    """Absolute names of what a node uses, by what it does with them."""

    publishes: frozenset[str]
    subscribes: frozenset[str]
    serves: frozenset[str]
    calls: frozenset[str]


def node_set_ups() -> dict[str, NodeSetUp]:
    """Every node of the launch files, by the path of its enclave."""
    real_time = {'publish_clock': 'false'}
    found = {
        '/pendulum/planner': _with('planner pendulum', '/pendulum', {}),
        '/pendulum/tracker': _with('tracker pendulum', '/pendulum', {}),
        '/pendulum/pendulum_plant': _with('pendulum_plant', '/pendulum', real_time),
        '/robots/planner': _with('planner robots', '/robots', {}),
    }
    for robot in DEFAULT_ROBOTS:
        namespace = f'/robots/{robot}'
        service = {'planner_service': '/robots/plan'}
        found[f'{namespace}/tracker'] = _with('tracker robot', namespace, service)
        found[f'{namespace}/robot_plant'] = _with('robot_plant', namespace, real_time)
    return found


def _with(name: str, namespace: str, parameters: Mapping[str, str]) -> NodeSetUp:
    known = SET_UPS[name]
    return replace(known, namespace=namespace, parameters={**known.parameters, **parameters})


def rights(set_up: NodeSetUp) -> Rights:
    """Return what a node uses, as it says itself."""
    with running(set_up) as node:
        used = {(end.kind, end.name) for end in used_by(node)}
        used.add(('publishes', '/rosout'))  # which has no publisher in Python
        if isinstance(node, ManagedNode):  # nor has this
            used.add(('publishes', f'{node.get_fully_qualified_name()}/transition_event'))
    kinds = ('publishes', 'subscribes', 'service', 'calls')
    return Rights(*(frozenset(name for k, name in used if k == kind) for kind in kinds))


def policy() -> str:
    """Return config/security/policy.xml."""
    found = {path: rights(set_up) for path, set_up in node_set_ups().items()}
    found[OPERATOR] = operator(found)
    root = Element('policy', version='0.2.0')
    contexts = SubElement(root, 'contexts')
    for path, node in found.items():
        namespace, _, name = path.rpartition('/')
        profiles = SubElement(SubElement(contexts, 'context', path=path), 'profiles')
        profile = SubElement(profiles, 'profile', ns=namespace or '/', node=name)
        for group, item, right, names in (
            ('services', 'service', 'reply', node.serves),
            ('services', 'service', 'request', node.calls),
            ('topics', 'topic', 'publish', node.publishes),
            ('topics', 'topic', 'subscribe', node.subscribes),
        ):
            if names:
                allowed = SubElement(profile, group, {right: 'ALLOW'})
                for topic in sorted(names):
                    SubElement(allowed, item).text = topic
    indent(root)
    return _HEAD.format(operator=OPERATOR) + tostring(root, encoding='unicode') + '\n'


def operator(nodes: Mapping[str, Rights]) -> Rights:
    """Return what people's tools may do: look at everything, ask, set parameters and goals."""
    published = frozenset().union(*(node.publishes for node in nodes.values()))
    listened = frozenset().union(*(node.subscribes for node in nodes.values()))
    return Rights(
        publishes=frozenset(
            [*(name for name in listened if name.endswith(_GOALS)), *_OF_EVERY_NODE]
        ),
        subscribes=published,
        serves=frozenset(),
        calls=frozenset().union(*(node.serves for node in nodes.values())),
    )
