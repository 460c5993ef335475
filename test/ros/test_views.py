# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Views for RViz and Foxglove: well formed, and nothing in them that the nodes do not have."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
import json
from pathlib import Path
import re
from typing import Any, NamedTuple

import pytest
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'
PLANTS = ('pendulum', 'robots')
ROBOTS = ('robot1', 'robot2', 'robot3')


class Use(NamedTuple):
    """A topic that a view subscribes or publishes, with what it takes it for."""

    topic: str
    types: tuple[str, ...]
    latched: bool | None = None  # None: the viewer adapts to what is offered
    publishes: bool = False
    field: str = ''


TYPES = {  # of what a display or a tool of RViz handles
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'RobotModel': 'std_msgs/msg/String',
    'Path': 'nav_msgs/msg/Path',
    'SetGoal': 'geometry_msgs/msg/PoseStamped',
}


def rviz(plant: str) -> Any:
    return yaml.safe_load((CONFIG / f'{plant}.rviz').read_text(encoding='utf-8'))


def entries(items: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the displays or tools, those in groups as well."""
    for item in items:
        yield item
        yield from entries(item.get('Displays', []))


def rviz_uses(plant: str) -> Iterator[Use]:
    manager = rviz(plant)['Visualization Manager']
    for item in entries([*manager['Displays'], *manager['Tools']]):
        kind = item['Class'].split('/')[1]
        topic = item.get('Topic') or item.get('Description Topic')
        if topic is None:
            assert kind not in TYPES
            continue
        assert topic['Reliability Policy'] == 'Reliable'
        assert topic['History Policy'] == 'Keep Last'
        latched = {'Transient Local': True, 'Volatile': False}[topic['Durability Policy']]
        yield Use(topic['Value'], (TYPES[kind],), latched, publishes=kind == 'SetGoal')


def foxglove(plant: str) -> Any:
    return json.loads((CONFIG / 'foxglove' / f'{plant}.json').read_text(encoding='utf-8'))


def panels(plant: str, kind: str) -> Iterator[dict[str, Any]]:
    for name, settings in foxglove(plant)['configById'].items():
        if name.split('!')[0] == kind:
            yield settings


def foxglove_uses(plant: str) -> Iterator[Use]:
    for scene in panels(plant, '3D'):
        for topic in scene['topics']:
            yield Use(topic, (TYPES['MarkerArray'], TYPES['Path']))
        if pose := scene.get('publish', {}).get('poseTopic'):
            yield Use(pose, (TYPES['SetGoal'],), publishes=True)
        for layer in scene['layers'].values():
            if layer['layerId'] == 'foxglove.Urdf':
                yield Use(layer['topic'], ('std_msgs/msg/String',))
    for plot in panels(plant, 'Plot'):
        for path in plot['paths']:
            topic, _, field = path['value'].partition('.')
            yield Use(topic, ('sensor_msgs/msg/JointState', 'nav_msgs/msg/Odometry'), field=field)
    for raw in panels(plant, 'RawMessages'):
        topic, _, field = raw['topicPath'].partition('.')
        yield Use(topic, ('std_msgs/msg/String',), field=field)
    for diagnostics in panels(plant, 'DiagnosticSummary'):
        yield Use(diagnostics['topicToRender'], ('diagnostic_msgs/msg/DiagnosticArray',))


@pytest.fixture(scope='module')
def running(ros: Any) -> Any:
    """Every node that the views are for; the topics of robot2 and robot3 are robot1's."""
    for module, plant, namespace in (
        ('tdm_planner.nodes.planner', 'pendulum', '/pendulum'),
        ('tdm_planner.nodes.tracker', 'pendulum', '/pendulum'),
        ('tdm_sim.pendulum_plant', 'pendulum', '/pendulum'),
        ('tdm_planner.nodes.planner', 'robots', '/robots'),
        ('tdm_sim.robot_plant', 'robots', '/robots/robot1'),
    ):
        file = str(CONFIG / f'{plant}.yaml')
        ros.start(module, namespace=namespace, arguments=['--params-file', file])
    return ros


def of_robot1(topic: str) -> str:
    return re.sub(r'/robot\d/', '/robot1/', topic)


@pytest.mark.parametrize('plant', PLANTS)
def test_every_topic_and_service_is_there_with_its_type_and_quality_of_service(
    running: Any, plant: str
) -> None:
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    node = running.node
    for use in (*rviz_uses(plant), *foxglove_uses(plant)):
        topic = of_robot1(use.topic)
        ask = node.get_subscriptions_info_by_topic
        if not use.publishes:
            ask = node.get_publishers_info_by_topic
        assert running.spin_until(lambda ask=ask, topic=topic: ask(topic), 30.0), topic
        for end in ask(topic):
            assert end.topic_type in use.types, use
            assert end.qos_profile.reliability == ReliabilityPolicy.RELIABLE, use
            durable = end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert use.latched in (None, durable), use
        if use.field:
            check_field(ask(topic)[0].topic_type, use.field)
    called = {of_robot1(panel['serviceName']) for panel in panels(plant, 'CallService')}
    assert f'/{plant}/plan' in called
    assert running.spin_until(lambda: called <= set(services(node)), 20.0)
    assert all(services(node)[name] == ['std_srvs/srv/Trigger'] for name in called)
    assert all(json.loads(panel['requestPayload']) == {} for panel in panels(plant, 'CallService'))


def services(node: Any) -> dict[str, list[str]]:
    return dict(node.get_service_names_and_types())


def check_field(type_name: str, path: str) -> None:
    """Follow `a.b[0]` from an empty message; what a list holds is left to the next test."""
    package, _, name = type_name.split('/')
    value = getattr(import_module(f'{package}.msg'), name)()
    for part in path.split('.'):
        value = getattr(value, part.split('[')[0])


@pytest.mark.parametrize('plant', PLANTS)
def test_what_is_plotted_is_what_the_label_says(running: Any, plant: str) -> None:
    """Indices into the joints, against the names in messages."""
    from sensor_msgs.msg import JointState

    joints = {
        ('pendulum', 'joint_states'): {'theta': 'pendulum', 'psi': 'disk', 'theta_dot': 'pendulum',
                                       'psi_dot': 'disk', 'applied': 'disk'},
        ('robots', 'joint_states'): {'effort[0]': 'thruster', 'effort[1]': 'reaction_wheel',
                                     'position[0]': 'thruster'},
    }  # fmt: skip
    checked = 0
    for plot in panels(plant, 'Plot'):
        for path in plot['paths']:
            topic, _, field = path['value'].partition('.')
            wanted = joints.get((plant, topic.rsplit('/', 1)[1]))
            if wanted is None:
                continue
            received = running.subscribe(of_robot1(topic), JointState)
            assert running.spin_until(lambda received=received: bool(received), 20.0), topic
            index = int(field.split('[')[1].rstrip(']'))
            key = path['label'] if plant == 'pendulum' else field
            assert received[-1].name[index] == wanted[key]
            checked += 1
    assert checked >= 5
