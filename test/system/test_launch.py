# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The launch files, executed with stand-ins for the few classes of `launch` they use.

`launch` is not available as a wheel. Where ROS 2 is installed see test_real_launch.py as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from launch_stand_ins import description, ExecuteProcess, SOURCE, stand_ins  # noqa: F401
import pytest
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.resources import config_file
from tdm_sim.record_command import record_command
import yaml

COMMON = {
    *('params_file', 'namespace', 'plant', 'rviz', 'record', 'bag', 'respawn', 'log_level'),
    *('use_sim_time', 'enclaves'),
}
FILES = sorted(path.name for path in (SOURCE / 'launch').glob('*.launch.py'))


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_every_argument_is_described_and_has_a_default(name: str):
    arguments = {a.name: a for a in description(name).arguments()}
    assert set(arguments) >= COMMON
    for argument in arguments.values():
        assert argument.description
        assert argument.choices is None or argument.default_value in argument.choices
    params_file = Path(arguments['params_file'].default_value)
    assert params_file == config_file(f'{name.split(".")[0]}.yaml')
    assert params_file.read_text() == (SOURCE / 'config' / params_file.name).read_text()
    assert arguments['namespace'].default_value == name.split('.')[0]


@pytest.mark.usefixtures('stand_ins')
def test_pendulum_starts_planner_tracker_and_plant():
    nodes = description('pendulum.launch.py').nodes(description='false')
    assert {n.executable for n in nodes} == {'planner', 'tracker', 'pendulum_plant'}
    for node in nodes:
        assert node.package == 'tdm_planner'
        assert node.namespace == 'pendulum'
        assert node.parameters == [str(config_file('pendulum.yaml'))]
        assert node.ros_arguments == ['--log-level', 'info']


@pytest.mark.usefixtures('stand_ins')
def test_pendulum_takes_its_arguments(tmp_path: Path):
    mine = tmp_path / 'my.yaml'
    mine.touch()
    nodes = description('pendulum.launch.py').nodes(
        plant='False',
        description='0',
        namespace='rig',
        params_file=str(mine),
        log_level='debug',
    )
    assert {n.executable for n in nodes} == {'planner', 'tracker'}
    for node in nodes:
        assert (node.namespace, node.parameters) == ('rig', [str(mine)])
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
@pytest.mark.parametrize('name', FILES)
def test_only_sections_count_that_the_planner_takes(name: str, tmp_path: Path):
    path = tmp_path / 'mine.yaml'
    mine = {'plant': {'mass': 0.05}, 'robots': ['mine']}
    others = {'plant': {'mass': 0.07}, 'robots': ['others', 'theirs']}
    document = {
        '/hall/planner': {'ros__parameters': mine},
        '/attic/planner': {'ros__parameters': others},
    }
    path.write_text(yaml.safe_dump(document, sort_keys=False))
    launch = description(name)
    nodes = launch.nodes(params_file=str(path), namespace='hall')
    if name.startswith('pendulum'):
        (publisher,) = (n for n in nodes if n.package == 'robot_state_publisher')
        assert '<mass value="0.05"' in publisher.parameters[0]['robot_description'].value
    else:
        assert {n.namespace for n in nodes} == {'hall', 'hall/mine'}
    with pytest.raises(InvalidProblem, match="'/cellar/planner', only for /hall/planner, /attic"):
        launch.nodes(params_file=str(path), namespace='cellar')


@pytest.mark.usefixtures('stand_ins')
def test_numbers_are_read_as_the_nodes_do(tmp_path: Path):
    """YAML 1.1 takes 3e-5 for a text, ROS 2 for a number."""
    path = tmp_path / 'small.yaml'
    path.write_text('/**/planner:\n  ros__parameters:\n    plant: {mass: 5e-2}\n')
    nodes = description('pendulum.launch.py').nodes(params_file=str(path))
    (publisher,) = (n for n in nodes if n.package == 'robot_state_publisher')
    assert '<mass value="0.05"' in publisher.parameters[0]['robot_description'].value
    path.write_text(
        '/**/planner:\n  ros__parameters:\n    robots: [left]\n    left: {start: {x: 5e-1}}\n'
    )
    nodes = description('robots.launch.py').nodes(params_file=str(path), rviz='true')
    (plant,) = (n for n in nodes if n.executable == 'robot_plant')
    assert plant.parameters[1]['initial.x'] == 0.5


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_all_nodes_follow_the_simulated_time_on_request(name: str):
    clock = {'use_sim_time': True}
    assert all(
        n.parameters[-1] == clock
        for n in description(name).nodes(use_sim_time='true', rviz='true')
    )
    assert not any(clock in n.parameters for n in description(name).nodes(rviz='true'))


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_nodes_run_in_enclaves_of_the_policy_on_request(name: str):
    policy = ElementTree.parse(SOURCE / 'config' / 'security' / 'policy.xml').getroot()
    known = {item.get('path') for item in policy.iter('context')}
    for node in description(name).nodes(enclaves='true'):
        if node.package == 'tdm_planner':
            option, enclave = node.ros_arguments[-2:]
            assert option == '--enclave'
            assert enclave in known
            assert enclave == f'/{node.namespace}/{node.executable}'
    assert not any('--enclave' in n.ros_arguments for n in description(name).nodes())


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


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('pushed', ['site', '/site'])
@pytest.mark.parametrize(
    ('name', 'topic'),
    [('pendulum', '/site/hall/plant_markers'), ('robots', '/site/hall/robot2/goal_pose')],
)
def test_absolute_names_have_a_namespace_that_is_pushed(pushed: str, name: str, topic: str):
    """Those of nodes are left to launch_ros, which puts it before relative ones."""
    arguments = {'rviz': 'true', 'record': 'true', 'bag': 'bag', 'enclaves': 'true'}
    started = description(f'{name}.launch.py').started(pushed, namespace='hall', **arguments)
    (recorder,) = (item for item in started if isinstance(item, ExecuteProcess))
    assert recorder.cmd == record_command('site/hall', 'bag')
    (rviz,) = (item for item in started if getattr(item, 'package', '') == 'rviz2')
    assert f'Value: {topic}\n' in Path(rviz.arguments[1]).read_text()
    nodes = [item for item in started if getattr(item, 'package', '') == 'tdm_planner']
    for node in nodes:
        assert node.namespace.split('/')[0] == 'hall'
        enclave = node.ros_arguments[-1]
        assert enclave == f'/site/{node.namespace}/{node.executable}'
        if node.executable == 'tracker' and name == 'robots':
            assert node.parameters[1]['planner_service'] == '/site/hall/plan'


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_the_section_of_a_pushed_namespace_is_taken(name: str, tmp_path: Path):
    path = tmp_path / 'mine.yaml'
    mine = {'plant': {'mass': 0.05}, 'robots': ['mine']}
    path.write_text(yaml.safe_dump({'/site/hall/planner': {'ros__parameters': mine}}))
    assert description(name).nodes('/site', params_file=str(path), namespace='hall')
    with pytest.raises(InvalidProblem, match="'/hall/planner'"):
        description(name).nodes(params_file=str(path), namespace='hall')


ROBOTS = {
    '/**/planner': {
        'ros__parameters': {
            'robots': ['left', 'right'],
            'left': {'start': {'x': 1, 'y': 2.0}},
            'right': {'start': {'yaw': 0.5}},
            'start': {'source': 'measured'},
        }
    },
    '/**/tracker': {'ros__parameters': {'kind': 'robot'}},
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
def test_fewer_robots_than_the_file_names(robots_file: str):
    nodes = description('robots.launch.py').nodes(params_file=robots_file, number_of_robots='1')
    assert {(n.executable, n.namespace) for n in nodes} == {
        ('planner', 'robots'),
        ('robot_plant', 'robots/left'),
        ('tracker', 'robots/left'),
    }
    (planner,) = (n for n in nodes if n.executable == 'planner')
    assert planner.parameters == [robots_file, {'robots': ['left']}]


@pytest.mark.usefixtures('stand_ins')
def test_more_robots_than_the_file_names():
    nodes = description('robots.launch.py').nodes(number_of_robots='5')
    plants = {n.namespace: n.parameters[1] for n in nodes if n.executable == 'robot_plant'}
    assert set(plants) == {f'robots/robot{k}' for k in range(1, 6)}
    (planner,) = (n for n in nodes if n.executable == 'planner')
    changed = planner.parameters[1]
    assert changed['robots'] == [f'robot{k}' for k in range(1, 6)]
    for name in ('robot4', 'robot5'):
        assert plants[f'robots/{name}']['initial.x'] == changed[f'{name}.start.x']
        assert len(changed[f'formation.{name}']) == 3


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('number', ['0', '-1', 'two', '99'])
def test_numbers_of_robots_that_cannot_be_are_refused(number: str):
    with pytest.raises(InvalidProblem, match='number_of_robots'):
        description('robots.launch.py').nodes(number_of_robots=number)


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_only_trackers_are_started_anew(name: str):
    """After a pause, that Ctrl-C may come first; and not for ever."""
    for node in description(name).nodes():
        assert node.respawn == (node.executable == 'tracker')
        if node.respawn:
            assert node.respawn_delay is not None
            assert node.respawn_delay >= 1.0
            assert node.respawn_max_retries > 0
    assert not any(node.respawn for node in description(name).nodes(respawn='false'))


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_recording_on_request(name: str, monkeypatch: pytest.MonkeyPatch):
    def recorders(**arguments: str) -> list[ExecuteProcess]:
        started = description(name).started(**arguments)
        return [item for item in started if isinstance(item, ExecuteProcess)]

    assert not recorders()
    (recorder,) = recorders(record='true', bag='my_bag', namespace='hall')
    assert recorder.cmd == record_command('hall', 'my_bag')
    asked: list[bool] = []

    def command(namespace: str, bag: str, use_sim_time: bool) -> list[str]:
        asked.append(use_sim_time)
        return []

    monkeypatch.setattr('tdm_planner.launching.record_command', command)
    for switch in ('true', 'false'):
        recorders(record='true', use_sim_time=switch)
    assert asked == [True, False]


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_the_log_level_is_that_of_all_nodes(name: str):
    for node in description(name).nodes(log_level='debug', rviz='true'):
        assert node.ros_arguments == ['--log-level', 'debug']


@pytest.mark.usefixtures('stand_ins')
def test_trackers_of_robots_ask_the_planner_of_their_namespace(robots_file: str):
    nodes = description('robots.launch.py').nodes(params_file=robots_file, namespace='hall/a')
    trackers = [n for n in nodes if n.executable == 'tracker']
    assert [n.namespace for n in trackers] == ['hall/a/left', 'hall/a/right']
    for node in trackers:
        assert node.parameters[1] == {'kind': 'robot', 'planner_service': '/hall/a/plan'}


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
    path.write_text(yaml.safe_dump({'/**/planner': {'ros__parameters': {'robots': robots}}}))
    with pytest.raises(InvalidProblem, match="'robots'"):
        description('robots.launch.py').nodes(params_file=str(path))
