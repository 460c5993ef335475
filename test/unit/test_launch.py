# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What the launch files start, and what they refuse, with stand-ins for `launch`."""

import os
from pathlib import Path
import shutil
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import launch_stand_ins
from launch_stand_ins import described, ExecuteProcess, Node, stand_ins  # noqa: F401
import pytest
from rclpy.logging import get_logging_directory
from ros_harness import SOURCE
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import config_file
import yaml

pytestmark = pytest.mark.usefixtures('stand_ins')
BOTH = pytest.mark.parametrize('name', ['pendulum', 'robots'])


def nodes(name: str, pushed: str | None = None, **arguments: str) -> list[Node]:
    started = described(name).started(pushed, **arguments)
    return [item for item in started if isinstance(item, Node)]


def places(found: list[Node]) -> set[tuple[str, str]]:
    return {(node.executable, node.namespace) for node in found}


def one(found: list[Any], name: str) -> Any:
    (node,) = (item for item in found if getattr(item, 'executable', '') == name)
    return node


def refused(name: str, words: str, pushed: str | None = None, **arguments: str) -> None:
    with pytest.raises(InvalidProblem, match=words):
        described(name).started(pushed, **arguments)


def description(found: list[Any]) -> Any:
    return one(found, 'robot_state_publisher').parameters[0]['robot_description']


def written(folder: Path, sections: dict[str, Any]) -> str:
    """Write a parameter file; a number as text becomes one that YAML 1.1 takes for a text."""
    document = {name: {'ros__parameters': values} for name, values in sections.items()}
    path = folder / 'mine.yaml'
    path.write_text(yaml.safe_dump(document, sort_keys=False).replace("'5e-2'", '5e-2'))
    return str(path)


def test_the_pendulum_is_described_with_the_plant_of_the_parameter_file(tmp_path: Path):
    path = written(tmp_path, {'/**/planner': {'plant': {'mass': '5e-2', 'arm_length': 0.2}}})
    found = nodes('pendulum', params_file=path, namespace='/rig')
    assert one(found, 'robot_state_publisher').namespace == 'rig'
    given = description(found)
    assert given.value_type is str  # or launch would read the XML as YAML
    assert '<mass value="0.05"' in given.value
    assert 'xyz="0.2 0 0"' in given.value


@BOTH
@pytest.mark.parametrize('pushed', [None, 'site'])
def test_only_sections_count_that_the_planner_takes(name: str, pushed: str | None, tmp_path: Path):
    above = '/site' if pushed else ''
    sections = {
        f'{above}/hall/planner': {'plant': {'mass': 0.05}, 'robots': ['mine']},
        f'{above}/attic/planner': {'plant': {'mass': 0.07}, 'robots': ['others', 'theirs']},
    }
    path = written(tmp_path, sections)
    found = nodes(name, pushed, params_file=path, namespace='hall')
    if name == 'pendulum':
        assert '<mass value="0.05"' in description(found).value
    else:
        assert {node.namespace for node in found} == {'hall', 'hall/mine'}
    words = r"cellar/planner', only for .*hall/planner, .*attic"
    refused(name, words, pushed, params_file=path, namespace='cellar')
    if pushed:
        refused(name, "'/hall/planner'", params_file=path, namespace='hall')


@BOTH
def test_what_holds_for_all_nodes(name: str):
    """Simulated time, the level of the log; enclaves, those of the policy, are for ours."""
    clock = {'use_sim_time': True}
    for node in nodes(name, rviz='true'):
        assert clock not in node.parameters
        # Only trackers are started anew: after a pause, that Ctrl-C may come first; not for ever.
        assert node.respawn == (node.executable == 'tracker')
        assert not node.respawn or (node.respawn_delay >= 1.0 and node.respawn_max_retries > 0)
    assert not any(node.respawn for node in nodes(name, respawn='false'))
    changed = nodes(name, rviz='true', use_sim_time='true', log_level='debug')
    assert all(node.parameters[-1] == clock for node in changed)
    assert all(node.ros_arguments == ['--log-level', 'debug'] for node in changed)
    of_one = nodes(name, log_level='tracker:=DEBUG')
    assert all(node.ros_arguments == ['--log-level', 'tracker:=DEBUG'] for node in of_one)
    refused(name, "'loud' is not allowed: must be one of .*debug, info, warn", log_level='loud')
    policy = ElementTree.parse(SOURCE / 'config' / 'security' / 'policy.xml').getroot()
    known = {item.get('path') for item in policy.iter('context')}
    for node in nodes(name, enclaves='true'):
        if node.package == 'tdm_planner':
            enclave = f'/{node.namespace}/{node.executable}'
            assert node.ros_arguments[-2:] == ['--enclave', enclave]
            assert enclave in known
    started = described(name).started()
    assert not [item for item in started if isinstance(item, ExecuteProcess)]
    assert 'rviz2' not in {item.executable for item in started}


@pytest.mark.parametrize('pushed', [None, 'site', '/site'])
@BOTH
def test_absolute_names_have_the_namespaces_before_them(pushed: str | None, name: str):
    """A namespace that is pushed too; of relative names launch_ros takes care."""
    topic = {'pendulum': 'plant_markers', 'robots': 'robot2/goal_pose'}[name]
    arguments = {'rviz': 'true', 'record': 'true', 'bag': 'bag', 'enclaves': 'true'}
    started = described(name).started(pushed, namespace='hall', **arguments)
    above = 'site/' if pushed else ''
    (recorder,) = (item for item in started if isinstance(item, ExecuteProcess))
    space = ['--namespace', f'/{above}hall']
    assert recorder.cmd[1:] == ['record', '--quiet', '--output', 'bag', *space]
    assert Path(recorder.cmd[0]).name == 'tdm'
    option, file = one(started, 'rviz2').arguments
    assert (option, Path(file).parent) == ('-d', get_logging_directory())
    assert f'Value: /{above}hall/{topic}\n' in Path(file).read_text()
    for node in started:
        if getattr(node, 'package', '') == 'tdm_planner':
            assert node.namespace.split('/')[0] == 'hall'
            assert node.ros_arguments[-1] == f'/{above}{node.namespace}/{node.executable}'
            if node.executable == 'tracker' and name == 'robots':
                own = {'kind': 'robot', 'planner_service': f'/{above}hall/plan'}
                assert node.parameters[1] == own


@BOTH
def test_what_cannot_be_started_is_said_before_anything_is(name: str, tmp_path: Path):
    refused(name, "file '/nowhere.yaml' cannot be read: No such", params_file='/nowhere.yaml')
    refused(name, "namespace = 'a b': Invalid namespace: namespace must not", namespace='a b')
    refused(name, 'is there already: name another folder', record='true', bag=str(tmp_path))
    programs = Path(os.environ['AMENT_PREFIX_PATH'], 'lib')
    shutil.rmtree(programs / 'rviz2')
    refused(name, "'rviz2' .* not installed.*, or launch with rviz:=false", rviz='true')
    (programs / 'tdm_planner/tracker').unlink()
    refused(name, "'tracker'")


@BOTH
def test_a_launch_ends_with_whatever_it_cannot_do_without(name: str):
    def ends(item: Any, code: int, shutdown: bool = False) -> bool:
        try:
            context = launch_stand_ins.LaunchContext({}, shutdown)
            item.on_exit(SimpleNamespace(returncode=code), context)
        except RuntimeError as error:
            assert f'ended with code {code}: the launch ends' in str(error)
            return True
        return False

    for plant in ('true', 'false'):
        for item in described(name).started(plant=plant, record='true'):
            if getattr(item, 'package', '') == 'robot_state_publisher':
                continue
            needed = plant == 'true' and getattr(item, 'executable', '') != 'tracker'
            assert ends(item, -9) == ends(item, 1) == needed
            assert ends(item, 2)  # it was started with what cannot be
            assert not ends(item, 0)
            assert not ends(item, 2, shutdown=True)


def initial_states(found: list[Any]) -> dict[str, Any]:
    return {node.namespace: node.parameters[1] for node in found if 'plant' in node.executable}


def test_robots_get_a_plant_and_a_tracker_each(tmp_path: Path):
    starts = {'left': {'start': {'x': 1, 'y': '5e-2'}}, 'right': {'start': {'yaw': 0.5}}}
    planner = {'robots': ['left', 'right'], **starts}
    two = written(tmp_path, {'/**/planner': planner, '/**/tracker': {'kind': 'robot'}})
    found = nodes('robots', params_file=two)
    left = {('robot_plant', 'robots/left'), ('tracker', 'robots/left')}
    right = {('robot_plant', 'robots/right'), ('tracker', 'robots/right')}
    assert places(found) == {('planner', 'robots')} | left | right
    assert all(node.parameters[0] == two for node in found)
    initial = initial_states(found)
    assert initial['robots/left'].items() >= {'initial.x': 1.0, 'initial.y': 0.05}.items()
    assert initial['robots/right'].items() >= {'initial.yaw': 0.5}.items()
    found = nodes('robots', params_file=two, number_of_robots='1')
    assert places(found) == {('planner', 'robots')} | left
    given = {'problem': 'robot_formation', 'robots': ['left']}
    assert one(found, 'planner').parameters == [two, given]
    real = nodes('robots', params_file=two, plant='false', namespace='')
    assert places(real) == {('planner', ''), ('tracker', 'left'), ('tracker', 'right')}
    assert real[1].parameters[1] == {'kind': 'robot', 'planner_service': '/plan'}


def test_more_robots_than_the_file_names_have_places_of_their_own():
    found = nodes('robots', number_of_robots='5')
    plants = initial_states(found)
    assert set(plants) == {f'robots/robot{k}' for k in range(1, 6)}
    starts = {(initial['initial.x'], initial['initial.y']) for initial in plants.values()}
    assert len(starts) == 5
    changed = one(found, 'planner').parameters[1]
    assert changed['robots'] == [f'robot{k}' for k in range(1, 6)]
    for name in ('robot4', 'robot5'):
        assert plants[f'robots/{name}']['initial.x'] == changed[f'{name}.start.x']
        assert len(changed[f'formation.{name}']) == 3


def test_a_file_for_another_problem_is_refused_and_one_that_names_none_is_for_this_one(tmp_path):
    for name, other in (('pendulum', 'robots'), ('robots', 'pendulum')):
        file = config_file(f'{other}.yaml')
        refused(name, f'{other}.yaml. is for problem = .*takes one for', params_file=str(file))
    found = nodes('robots', params_file=written(tmp_path, {'/**/planner': {}}))
    assert one(found, 'planner').parameters[1] == {'problem': 'robot_formation'}


def test_robots_that_cannot_be_are_refused(tmp_path: Path):
    for number in ('0', '-1', 'two', '99'):
        refused('robots', 'number_of_robots', number_of_robots=number)
    for robots in ([], ['left', 'left'], ['le ft'], 'left'):
        path = written(tmp_path, {'/**/planner': {'robots': robots}})
        refused('robots', "'robots'", params_file=path)
