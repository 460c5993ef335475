# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Topics and services of the running nodes against the tables of the documentation."""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any

import pytest

SOURCE = Path(__file__).resolve().parents[2]
# node, module, parameter file, namespace
NODES = [
    ('planner', 'tdm_planner.nodes.planner', 'pendulum', '/pendulum'),
    ('planner', 'tdm_planner.nodes.planner', 'robots', '/robots'),
    ('tracker', 'tdm_planner.nodes.tracker', 'pendulum', '/pendulum'),
    ('tracker', 'tdm_planner.nodes.tracker', 'robots', '/robots/robot1'),
    ('pendulum_plant', 'tdm_sim.pendulum_plant', 'pendulum', '/pendulum'),
    ('robot_plant', 'tdm_sim.robot_plant', 'robots', '/robots/robot1'),
]
OF_EVERY_NODE = re.compile(
    r'/(rosout|parameter_events|get_type_description)$'
    r'|/(describe|get|list|set)_parameter(s|_types)(_atomically)?$'
    r'|/(change_state|get_state|get_available_(states|transitions)|get_transition_graph)$'
    r'|/transition_event$'
)

ADDING_TOPICS = {
    'planner': ['-p', 'replan.rate:=1.0'],
    'pendulum_plant': ['-p', 'publish_clock:=true'],
    'robot_plant': ['-p', 'publish_clock:=true'],
}

Interface = tuple[str, str, str]  # name, kind, type


def documented(*pages: str) -> set[Interface]:
    """Return the rows of the tables of the nodes' pages."""
    found = set()
    for page in pages:
        text = (SOURCE / 'docs' / 'nodes' / f'{page}.md').read_text(encoding='utf-8')
        for line in text.splitlines():
            cells = [cell.strip() for cell in line.strip('|').split('|')]
            if len(cells) == 4 and cells[1] in ('publishes', 'subscribes', 'service', 'calls'):
                for kind in re.findall('`(.+?)`', cells[2]):
                    found |= {(name, cells[1], kind) for name in re.findall('`(.+?)`', cells[0])}
    assert found, pages
    return found


def offered(ros: Any, name: str, namespace: str) -> set[Interface]:
    """Return what a running node has, beside what every node has."""
    node = ros.node
    found = set()
    for kind, ask in (
        ('publishes', node.get_publisher_names_and_types_by_node),
        ('subscribes', node.get_subscriber_names_and_types_by_node),
        ('service', node.get_service_names_and_types_by_node),
        ('calls', node.get_client_names_and_types_by_node),
    ):
        for topic, types in ask(name, namespace):
            simulated_time = (kind, topic) == ('subscribes', '/clock')
            if not (simulated_time or OF_EVERY_NODE.search(topic)):
                relative = topic.removeprefix(f'{namespace}/')
                relative = re.sub(r'^robot\d/', '<robot>/', relative)
                relative = relative.removeprefix('/robots/')  # the planner's, above a robot's
                found |= {(relative, kind, re.sub('/(msg|srv)/', '/', t)) for t in types}
    return found


@pytest.fixture(scope='module')
def running(ros: Any) -> Any:
    for name, module, plant, namespace in NODES:
        file = str(SOURCE / 'config' / f'{plant}.yaml')
        arguments = ['--params-file', file, *ADDING_TOPICS.get(name, [])]
        ros.start(module, namespace=namespace, arguments=arguments)
    wanted = {(name, namespace) for name, _, _, namespace in NODES}
    assert ros.spin_until(
        lambda: wanted <= set(ros.node.get_node_names_and_namespaces()), timeout=30.0
    )
    return ros


@pytest.mark.parametrize('heading', ['planner', 'tracker', 'pendulum_plant, robot_plant'])
def test_tables_list_exactly_what_the_nodes_have(running: Any, heading: str):
    names = heading.split(', ')
    nodes = [(name, namespace) for name, _, _, namespace in NODES if name in names]
    expected = documented(*names)

    def found() -> set[Interface]:
        try:
            return set().union(*(offered(running, *node) for node in nodes))
        except Exception as error:  # noqa: B902
            # Until discovery knows the node's endpoints.
            if type(error).__name__ != 'NodeNameNonExistentError':
                raise
            return set()

    running.spin_until(lambda: found() == expected, timeout=15.0)
    assert sorted(found()) == sorted(expected)


@pytest.mark.parametrize(('name', 'namespace'), [(node[0], node[3]) for node in NODES])
def test_what_the_tables_leave_out_is_named(running: Any, name: str, namespace: str):
    """What ROS 2 gives to nodes by itself is exactly what the page lists in words."""
    text = (SOURCE / 'docs' / 'interfaces.md').read_text(encoding='utf-8')
    listed = text.partition('What ROS 2 gives to nodes')[2].partition('\n###')[0]
    of_every_node, of_managed_nodes = (
        {topic.removeprefix('/') for topic in re.findall('`(.+?)`', part)}
        for part in listed.split('\n- ')[1:]
    )
    expected = of_every_node - {'use_sim_time', 'clock'}
    if name in ('planner', 'tracker'):
        expected |= of_managed_nodes

    def found() -> set[str]:
        node = running.node
        topics = [
            topic
            for ask in (
                node.get_publisher_names_and_types_by_node,
                node.get_service_names_and_types_by_node,
            )
            for topic, _ in ask(name, namespace)
        ]
        return {topic.rpartition('/')[2] for topic in topics if OF_EVERY_NODE.search(topic)}

    running.spin_until(lambda: found() == expected, timeout=15.0)
    assert found() == expected
