# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Views for RViz and Foxglove: nothing in them that the nodes do not have."""

from collections.abc import Iterator
from importlib import import_module
import json
from pathlib import Path
import re
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import JointState
from stepped_ros import Stepped
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'
PLANTS = ('pendulum', 'robots')
TYPES = {  # of what a display or a tool of RViz handles
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'RobotModel': 'std_msgs/msg/String',
    'Path': 'nav_msgs/msg/Path',
    'SetGoal': 'geometry_msgs/msg/PoseStamped',
}


def rviz(plant: str) -> Any:
    return yaml.safe_load((CONFIG / f'{plant}.rviz').read_text(encoding='utf-8'))


def foxglove(plant: str) -> Any:
    return json.loads((CONFIG / 'foxglove' / f'{plant}.json').read_text(encoding='utf-8'))


def within(item: Any) -> Iterator[Any]:
    """Yield everything in a document: mappings, lists, keys and values."""
    yield item
    if isinstance(item, dict | list):
        parts = item if isinstance(item, list) else [*item, *item.values()]
        for part in parts:
            yield from within(part)


def of_robot1(topic: str) -> str:
    """Return the topic of robot1, which stands for all of them."""
    return re.sub(r'/robot\d/', '/robot1/', topic)


@pytest.fixture(scope='module')
def running(ros: Stepped) -> Stepped:
    for namespace, *names in (
        ('/pendulum', 'planner', 'tracker', 'pendulum_plant'),
        ('/robots', 'planner'),
        ('/robots/robot1', 'robot_plant'),
    ):
        file = str(CONFIG / f'{namespace.split("/")[1]}.yaml')
        for name in names:
            ros.start(name, None, namespace, ['--params-file', file])
    return ros


@pytest.mark.parametrize('plant', PLANTS)
def test_rviz_shows_topics_with_their_type_and_quality_of_service(running, plant):
    shown = [item for item in within(rviz(plant)) if isinstance(item, dict) and 'Class' in item]
    found = set()
    for item in shown:
        kind = item['Class'].rpartition('/')[2]
        topic = item.get('Topic') or item.get('Description Topic')
        assert (topic is None) == (kind not in TYPES)
        if topic is None:
            continue
        node, name = running.node, of_robot1(topic['Value'])
        ask = node.get_publishers_info_by_topic
        if kind == 'SetGoal':
            ask = node.get_subscriptions_info_by_topic
        assert running.meet(lambda ask=ask, name=name: bool(ask(name))), name
        assert topic['Reliability Policy'] == 'Reliable'
        latched = {'Transient Local': True, 'Volatile': False}[topic['Durability Policy']]
        for end in ask(name):
            assert end.topic_type == TYPES[kind], name
            assert end.qos_profile.reliability == ReliabilityPolicy.RELIABLE, name
            durable = end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert latched == durable, name
        found.add(kind)
    assert len(found) > 1


@pytest.mark.parametrize('plant', PLANTS)
def test_foxglove_shows_and_calls_what_is_there(running, plant):
    node, document = running.node, foxglove(plant)
    names = {of_robot1(text) for text in within(document) if str(text).startswith('/')}
    topics, services = map(
        dict, (node.get_topic_names_and_types(), node.get_service_names_and_types())
    )
    for name in names:
        topic, _, field = name.partition('.')
        if topic in services:
            assert services[topic] == ['std_srvs/srv/Trigger']
            continue
        package, _, kind = topics[topic][0].split('/')
        value = getattr(import_module(f'{package}.msg'), kind)()
        for part in field.split('.') if field else ():
            value = getattr(value, part.split('[')[0])
    assert {f'/{plant}/plan', f'/{plant}/markers', '/diagnostics'} <= names
    calls = [item for item in within(document) if isinstance(item, dict) and 'serviceName' in item]
    assert all(json.loads(item['requestPayload']) == {} for item in calls)


@pytest.mark.parametrize('plant', PLANTS)
def test_what_is_plotted_is_what_the_label_says(running, plant):
    """Indices into the joints, against the names in messages."""
    wanted = {
        'pendulum': {'theta': 'pendulum', 'psi': 'disk', 'theta_dot': 'pendulum',
                     'psi_dot': 'disk', 'applied': 'disk'},
        'robots': {'effort[0]': 'thruster', 'effort[1]': 'reaction_wheel',
                   'position[0]': 'thruster'},
    }[plant]  # fmt: skip
    curves = [item for item in within(foxglove(plant)) if isinstance(item, dict)]
    curves = [item for item in curves if '/joint_states.' in str(item.get('value'))]
    for curve in curves:
        topic, _, field = curve['value'].partition('.')
        received = running.subscribe(of_robot1(topic), JointState)
        assert running.spin_until(lambda received=received: bool(received)), topic
        index = int(field.split('[')[1].rstrip(']'))
        key = curve['label'] if plant == 'pendulum' else field
        assert received[-1].name[index] == wanted[key]
    assert len(curves) >= 5
