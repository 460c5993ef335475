# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The SROS2 policy against what the running nodes really use: neither more nor less."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

import pytest
from ros_harness import MODULES, Ros
from tools.generate import generated
from tools.security_policy import OPERATOR, Rights

POLICY = Path(__file__).resolve().parents[3] / 'config' / 'security' / 'policy.xml'
# Elements, their attributes (a * may be left out) and children, as sros2's policy.xsd has them.
SCHEMA: dict[str, tuple[set[str], set[str]]] = {
    'policy': ({'version'}, {'contexts'}),
    'contexts': (set(), {'context'}),
    'context': ({'path'}, {'profiles'}),
    'profiles': ({'type*'}, {'profile', 'metadata'}),
    'profile': ({'ns', 'node'}, {'topics', 'services', 'actions'}),
    'topics': ({'publish*', 'subscribe*'}, {'topic'}),
    'services': ({'reply*', 'request*'}, {'service'}),
    'topic': (set(), set()),
    'service': (set(), set()),
}
# Every kind of node once; the other robots' differ in their names alone.
STARTED: dict[str, dict[str, Any]] = {
    '/pendulum/planner': {'replan.rate': 1.0},
    '/pendulum/tracker': {},
    '/pendulum/pendulum_plant': {},
    '/robots/planner': {'problem': 'robot_formation', 'replan.rate': 1.0},
    '/robots/robot1/tracker': {'kind': 'robot', 'planner_service': '/robots/plan'},
    '/robots/robot1/robot_plant': {},
}


def document() -> ElementTree.Element:
    return ElementTree.parse(POLICY).getroot()


def granted(path: str) -> Rights:
    """Return what the policy allows an enclave."""
    (context,) = document().findall(f"contexts/context[@path='{path}']")

    def names(group: str, right: str) -> frozenset[str]:
        return frozenset(
            item.text for item in context.iterfind(f".//{group}[@{right}='ALLOW']/*") if item.text
        )

    return Rights(
        names('topics', 'publish'),
        names('topics', 'subscribe'),
        names('services', 'reply'),
        names('services', 'request'),
    )


def test_the_policy_is_up_to_date() -> None:
    assert generated()[POLICY] == POLICY.read_text(encoding='utf-8')


def test_the_policy_follows_the_schema() -> None:
    root = document()
    assert root.tag == 'policy'
    assert root.get('version') == '0.2.0'
    for element in root.iter():
        attributes, children = SCHEMA[element.tag]
        given = set(element.attrib)
        assert {name for name in attributes if not name.endswith('*')} <= given
        assert given <= {name.rstrip('*') for name in attributes}
        assert {child.tag for child in element} <= children
        assert len(element) or not children
        if element.tag in ('topics', 'services'):
            assert set(element.attrib.values()) == {'ALLOW'}
        if element.tag in ('topic', 'service'):
            assert re.fullmatch(r'(/[A-Za-z_][A-Za-z0-9_]*)+', element.text or '')


def test_every_enclave_is_that_of_its_node() -> None:
    contexts = document().findall('contexts/context')
    paths = [context.get('path') for context in contexts]
    assert len(set(paths)) == len(paths)
    for context in contexts:
        (profile,) = context.findall('profiles/profile')
        name = f'{profile.attrib["ns"].rstrip("/")}/{profile.attrib["node"]}'
        assert name == context.attrib['path']


@pytest.fixture(scope='module')
def used(ros: Ros) -> dict[str, Rights]:
    """Return what running nodes use, as the network sees them."""
    for path, parameters in STARTED.items():
        namespace, _, name = path.rpartition('/')
        ros.start(MODULES[name], parameters, namespace=namespace)

    def seen(path: str) -> Rights:
        namespace, _, name = path.rpartition('/')
        node = ros.node
        asks: tuple[Callable[..., Any], ...] = (
            node.get_publisher_names_and_types_by_node,
            node.get_subscriber_names_and_types_by_node,
            node.get_service_names_and_types_by_node,
            node.get_client_names_and_types_by_node,
        )
        return Rights(*(frozenset(item for item, _ in ask(name, namespace)) for ask in asks))

    def all_there() -> bool:
        names = {f'{ns}/{name}' for name, ns in ros.node.get_node_names_and_namespaces()}
        return set(STARTED) <= names and all(seen(path) == granted(path) for path in STARTED)

    ros.spin_until(all_there, 25.0)
    return {path: seen(path) for path in STARTED}


@pytest.mark.parametrize('path', STARTED)
@pytest.mark.parametrize('right', ['publishes', 'subscribes', 'serves', 'calls'])
def test_a_node_is_allowed_what_it_uses_and_nothing_else(
    used: dict[str, Rights], path: str, right: str
) -> None:
    assert getattr(granted(path), right) == getattr(used[path], right)


def test_no_node_may_command_anothers_actuators() -> None:
    """Torques come from the tracker of the plant, from nobody else."""
    for context in document().findall('contexts/context'):
        path = context.attrib['path']
        for topic in granted(path).publishes:
            if topic.endswith('/joint_command'):
                assert path == topic.replace('joint_command', 'tracker')


def test_operators_look_ask_and_set_goals_but_neither_command_nor_pretend_to_be_a_plant() -> None:
    rights = granted(OPERATOR)
    assert {name.rsplit('/', 1)[-1] for name in rights.publishes} == {
        'goal_pose', 'rosout', 'parameter_events',
    }  # fmt: skip
    assert {'/pendulum/plan', '/robots/plan'} <= rights.calls
    assert not rights.serves
