# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""The launch files, executed with stand-ins for the few classes of `launch` they use.

`launch` is not available as a wheel. Where ROS 2 is installed the files are loaded by it as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
import runpy
import sys
from types import ModuleType
from typing import Any

import pytest
from tdm_planner.exceptions import InvalidProblem
import yaml

SOURCE = Path(__file__).resolve().parents[1]
FILES = sorted(path.name for path in (SOURCE / 'launch').glob('*.launch.py'))


@dataclass(frozen=True)
class LaunchConfiguration:
    name: str

    def perform(self, context: Mapping[str, str]) -> str:
        return context[self.name]


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: str
    description: str
    choices: list[str] | None = None


@dataclass
class IfCondition:
    configuration: LaunchConfiguration


@dataclass
class OpaqueFunction:
    function: Any


@dataclass
class Node:
    package: str
    executable: str
    output: str
    namespace: Any = ''
    parameters: list[Any] = field(default_factory=list)
    arguments: list[str] = field(default_factory=list)
    ros_arguments: list[Any] = field(default_factory=list)
    condition: IfCondition | None = None


@dataclass
class ParameterValue:
    value: str
    value_type: type


@dataclass
class LaunchDescription:
    entities: list[Any] = field(default_factory=list)

    def nodes(self, **arguments: str) -> list[Node]:
        """Return the nodes that start for the given arguments, everything resolved."""
        context = {a.name: a.default_value for a in self.arguments()} | arguments
        found: list[Node] = []
        for entity in self.entities:
            made = entity.function(context) if isinstance(entity, OpaqueFunction) else [entity]
            found += [node for node in made if isinstance(node, Node)]
        for node in found:
            node.namespace = resolved(node.namespace, context)
            node.parameters = [resolved(item, context) for item in node.parameters]
            node.ros_arguments = [resolved(item, context) for item in node.ros_arguments]
        return [
            n
            for n in found
            if n.condition is None or n.condition.configuration.perform(context) == 'true'
        ]

    def arguments(self) -> list[DeclareLaunchArgument]:
        return [e for e in self.entities if isinstance(e, DeclareLaunchArgument)]


def resolved(item: Any, context: Mapping[str, str]) -> Any:
    return item.perform(context) if isinstance(item, LaunchConfiguration) else item


def module(name: str, **content: Any) -> ModuleType:
    made = ModuleType(name)
    vars(made).update(content)
    return made


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    for made in (
        module('launch', LaunchDescription=LaunchDescription, LaunchContext=dict),
        module(
            'launch.actions',
            DeclareLaunchArgument=DeclareLaunchArgument,
            OpaqueFunction=OpaqueFunction,
        ),
        module('launch.conditions', IfCondition=IfCondition),
        module('launch.substitutions', LaunchConfiguration=LaunchConfiguration),
        module('launch_ros'),
        module('launch_ros.actions', Node=Node),
        module('launch_ros.parameter_descriptions', ParameterValue=ParameterValue),
    ):
        monkeypatch.setitem(sys.modules, made.__name__, made)


def description(name: str) -> LaunchDescription:
    made = runpy.run_path(str(SOURCE / 'launch' / name))['generate_launch_description']()
    assert isinstance(made, LaunchDescription)
    return made


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_every_argument_is_described_and_has_a_default(name: str):
    arguments = {a.name: a for a in description(name).arguments()}
    assert {'params_file', 'namespace', 'plant', 'log_level'} <= set(arguments)
    for argument in arguments.values():
        assert argument.description
        assert argument.choices is None or argument.default_value in argument.choices
    params_file = Path(arguments['params_file'].default_value)
    assert params_file == SOURCE / 'config' / f'{name.split(".")[0]}.yaml'
    assert arguments['namespace'].default_value == name.split('.')[0]


@pytest.mark.usefixtures('stand_ins')
def test_pendulum_starts_planner_tracker_and_plant():
    nodes = description('pendulum.launch.py').nodes(description='false')
    assert {n.executable for n in nodes} == {'planner', 'tracker', 'pendulum_plant'}
    for node in nodes:
        assert node.package == 'tdm_planner'
        assert node.namespace == 'pendulum'
        assert node.parameters == [str(SOURCE / 'config' / 'pendulum.yaml')]
        assert node.ros_arguments == ['--log-level', 'info']


@pytest.mark.usefixtures('stand_ins')
def test_pendulum_takes_its_arguments():
    nodes = description('pendulum.launch.py').nodes(
        plant='false',
        description='false',
        namespace='rig',
        params_file='/my.yaml',
        log_level='debug',
    )
    assert {n.executable for n in nodes} == {'planner', 'tracker'}
    for node in nodes:
        assert (node.namespace, node.parameters) == ('rig', ['/my.yaml'])
        assert node.ros_arguments == ['--log-level', 'debug']


@pytest.mark.usefixtures('stand_ins')
def test_the_pendulum_is_described_with_the_plant_of_the_parameter_file(tmp_path: Path):
    path = tmp_path / 'mine.yaml'
    values = {'plant': {'mass': 0.05, 'arm_length': 0.2}}
    path.write_text(yaml.safe_dump({'/**/planner': {'ros__parameters': values}}))
    nodes = description('pendulum.launch.py').nodes(params_file=str(path), namespace='/rig')
    (publisher,) = (n for n in nodes if n.package == 'robot_state_publisher')
    assert publisher.namespace == 'rig'
    given = publisher.parameters[0]['robot_description']
    assert given.value_type is str  # or launch would read the XML as YAML
    assert '<mass value="0.05"' in given.value
    assert 'xyz="0.2 0 0"' in given.value


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize(
    ('name', 'topic'),
    [('pendulum', '/hall/plant_markers'), ('robots', '/hall/robot2/goal_pose')],
)
def test_rviz_opens_on_request_with_the_topics_of_the_namespace(name: str, topic: str):
    launch = description(f'{name}.launch.py')
    assert not [n for n in launch.nodes() if n.package == 'rviz2']
    nodes = description(f'{name}.launch.py').nodes(rviz='true', namespace='hall')
    (rviz,) = (n for n in nodes if n.package == 'rviz2')
    option, file = rviz.arguments
    assert option == '-d'
    assert f'Value: {topic}\n' in Path(file).read_text()


ROBOTS = {
    '/**/planner': {
        'ros__parameters': {
            'robots': ['left', 'right'],
            'left': {'start': {'x': 1, 'y': 2.0}},
            'right': {'start': {'yaw': 0.5}},
            'start': {'source': 'measured'},
        }
    },
    '/**/tracker': {'ros__parameters': {'plant': 'robot'}},
}


@pytest.fixture
def robots_file(tmp_path: Path) -> str:
    path = tmp_path / 'robots.yaml'
    path.write_text(yaml.safe_dump(ROBOTS))
    return str(path)


@pytest.mark.usefixtures('stand_ins')
def test_robots_get_a_plant_and_a_tracker_each(robots_file: str):
    nodes = description('robots.launch.py').nodes(params_file=robots_file)
    assert {(n.executable, n.namespace) for n in nodes} == {
        ('planner', 'robots'),
        ('robot_plant', 'robots/left'),
        ('tracker', 'robots/left'),
        ('robot_plant', 'robots/right'),
        ('tracker', 'robots/right'),
    }
    assert all(n.parameters[0] == robots_file for n in nodes)
    initial = {n.namespace: n.parameters[1] for n in nodes if n.executable == 'robot_plant'}
    assert initial['robots/left'].items() >= {'initial.x': 1.0, 'initial.y': 2.0}.items()
    assert initial['robots/right'].items() >= {'initial.yaw': 0.5}.items()


@pytest.mark.usefixtures('stand_ins')
def test_real_robots_need_no_plants(robots_file: str):
    nodes = description('robots.launch.py').nodes(
        params_file=robots_file, plant='false', namespace=''
    )
    assert [(n.executable, n.namespace) for n in nodes] == [
        ('planner', ''),
        ('tracker', 'left'),
        ('tracker', 'right'),
    ]
    assert nodes[1].parameters[1]['planner_service'] == '/plan'


@pytest.mark.usefixtures('stand_ins')
def test_trackers_of_robots_ask_the_planner_of_their_namespace(robots_file: str):
    nodes = description('robots.launch.py').nodes(params_file=robots_file, namespace='hall/a')
    trackers = [n for n in nodes if n.executable == 'tracker']
    assert [n.namespace for n in trackers] == ['hall/a/left', 'hall/a/right']
    for node in trackers:
        assert node.parameters[1] == {'plant': 'robot', 'planner_service': '/hall/a/plan'}


@pytest.mark.usefixtures('stand_ins')
def test_default_robots_stand_at_their_default_starts():
    nodes = description('robots.launch.py').nodes()
    plants = [n for n in nodes if n.executable == 'robot_plant']
    places = [(n.parameters[1]['initial.x'], n.parameters[1]['initial.y']) for n in plants]
    assert len(set(places)) == len(plants) == 3


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('robots', [[], ['left', 'left'], ['le ft'], 'left'])
def test_names_that_cannot_be_used_are_refused(tmp_path: Path, robots: Any):
    path = tmp_path / 'wrong.yaml'
    path.write_text(yaml.safe_dump({'planner': {'ros__parameters': {'robots': robots}}}))
    with pytest.raises(InvalidProblem, match="'robots'"):
        description('robots.launch.py').nodes(params_file=str(path))


@pytest.mark.parametrize('name', FILES)
def test_ros_itself_loads_the_file(name: str):
    sources = pytest.importorskip('launch.launch_description_sources')
    pytest.importorskip('launch_ros.actions')
    source = sources.PythonLaunchDescriptionSource(str(SOURCE / 'launch' / name))
    launch = pytest.importorskip('launch')
    assert source.get_launch_description(launch.LaunchContext()).entities
