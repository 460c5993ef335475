# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What README and documentation tell people to type works; what they open is there.

Commands of this package are run. Those that need a ROS 2 installation, start processes that run on
(demo, nodes, recordings: other tests run these) or build are checked against what is declared.
"""

from __future__ import annotations

import argparse
from configparser import ConfigParser
from functools import cache
from importlib.util import find_spec
from pathlib import Path
import re
import shutil
from typing import Any
from xml.etree import ElementTree

from pages import blocks, name_of, PAGES, SHARE, typed
import pytest
from ros_harness import SOURCE
from tdm_planner import cli
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.registry import problem_names
from tools.node_tables import declared_arguments
import yaml

LONG = 60.0  # s; results are tested here, not how soon they come on a busy machine
EVERY_PAGE = pytest.mark.parametrize('page', PAGES, ids=name_of)
OF_OTHER_PROJECTS = {'cd', 'mkdir', 'git', 'sudo', 'rosdep', 'colcon', '.', 'source'}
MODULES_OF_OTHER_PROJECTS = {'colcon', 'venv'}
SERVICES = {'plan', 'reset', 'push'}
VARIABLES = {
    'ROS_SECURITY_KEYSTORE': '.+',
    'ROS_SECURITY_ENABLE': 'true|false',
    'ROS_SECURITY_STRATEGY': 'Enforce|Permissive',
    'ROS_SECURITY_ENCLAVE_OVERRIDE': '/.+',
}


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = Problem.solve

    def solve_patiently(self: Problem, deadline: float | None = None, **options: Any) -> Solution:
        return solve(self, LONG, **options)

    monkeypatch.setattr(Problem, 'solve', solve_patiently)


@EVERY_PAGE
def test_examples_run_or_can_be_parsed(page: Path):
    for block in blocks(page, 'python'):
        exec(compile(block, name_of(page), 'exec'), {})
    for block in blocks(page, 'yaml'):
        assert yaml.safe_load(block)
    for block in blocks(page, 'xml'):
        ElementTree.fromstring(block)
    for block in blocks(page, 'ini'):
        ConfigParser().read_string(block)


@EVERY_PAGE
def test_commands_do_what_they_say(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """In order, in a folder that has the package's parameter files."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SOURCE / 'config', tmp_path / 'config')
    for command in typed(page):
        check_command(command)


def check_command(command: list[str]) -> None:
    while '=' in command[0]:
        check_variable(command[0])
        command = command[1:]
    check = CHECKS.get(command[0])
    assert check is not None or command[0] in OF_OTHER_PROJECTS, command
    if check is not None:
        check(command)


def check_variable(assignment: str) -> None:
    """Check that a variable is one of ROS 2, and its value one that it takes."""
    name, _, value = assignment.partition('=')
    assert re.fullmatch(VARIABLES[name], value), assignment
    if name == 'ROS_SECURITY_ENCLAVE_OVERRIDE':
        assert value in enclaves(), assignment


def check_export(command: list[str]) -> None:
    assert len(command) == 2, command
    check_variable(command[1])


def check_tdm(command: list[str]) -> None:
    options = cli._parser().parse_args(command[1:])  # exits for what is wrong
    made = getattr(options, 'output', None)
    installed = {*cli.SHORT_NAMES, *problem_names()}
    runs = command[1] == 'plan' and options.problem in installed
    runs = runs or (command[1] == 'report' and Path(command[2]).is_file())
    if runs:
        assert cli.main(command[1:]) == 0, command
        for path in (made, getattr(options, 'plot', None)):
            assert path is None or path.stat().st_size > 0


def check_make(command: list[str]) -> None:
    makefile = (SOURCE / 'Makefile').read_text(encoding='utf-8')
    first = command.index('-C') + 2 if '-C' in command else 1
    for target in command[first:]:
        if '=' not in target:
            assert re.search(rf'^{target}:', makefile, re.MULTILINE), target


def check_copy(command: list[str]) -> None:
    _, source, target = command
    shutil.copy(source, target)


def check_ros2(command: list[str]) -> None:
    {
        'launch': check_launch,
        'run': check_run,
        'service': check_service,
        'param': check_param,
        'lifecycle': check_lifecycle,
        'bag': lambda _: None,
        'security': check_security,
    }[command[1]](command)


@cache
def enclaves() -> frozenset[str]:
    """Return the paths of the enclaves that the policy has."""
    policy = ElementTree.parse(SOURCE / 'config' / 'security' / 'policy.xml')
    return frozenset(context.get('path', '') for context in policy.iter('context'))


def check_security(command: list[str]) -> None:
    """Check a command of SROS2 by its options, and that the files it is given are there."""
    parser = argparse.ArgumentParser(allow_abbrev=False)
    verbs = parser.add_subparsers(required=True, dest='verb')
    verbs.add_parser('create_keystore').add_argument('keystore', type=Path)
    artifacts = verbs.add_parser('generate_artifacts')
    artifacts.add_argument('-k', dest='keystore', type=Path, required=True)
    artifacts.add_argument('-e', dest='enclaves', nargs='*', default=[])
    artifacts.add_argument('-p', dest='policies', nargs='*', type=Path, default=[])
    verbs.add_parser('generate_policy').add_argument('policy', type=Path)
    given = parser.parse_args(command[2:])  # exits for what is wrong
    if given.verb == 'create_keystore':
        given.keystore.mkdir()
    elif given.verb == 'generate_artifacts':
        assert given.keystore.is_dir(), command
        assert given.policies or given.enclaves, command
        assert all(path.is_file() for path in given.policies), command
        assert set(given.enclaves) <= enclaves(), command


def check_param(command: list[str]) -> None:
    """Check that a node has the parameter that is set."""
    pytest.importorskip('rclpy')
    from tools.node_parameters import parameters_by_node

    _, _, verb, node, name, _ = command
    assert verb == 'set', command
    kind = node.rsplit('/', 1)[-1]
    assert any(
        name in parameters
        for found, parameters in parameters_by_node().items()
        if found.split()[0] == kind
    ), command


def check_lifecycle(command: list[str]) -> None:
    """Check that the node is a managed one, and the transition one that it has."""
    pytest.importorskip('rclpy')
    from tdm_planner.nodes.planner import Planner
    from tdm_planner.nodes.tracker import TrackerNode

    _, _, verb, node, transition = command
    assert verb == 'set', command
    kind = {'planner': Planner, 'tracker': TrackerNode}[node.rsplit('/', 1)[-1]]
    assert callable(getattr(kind, f'trigger_{transition}', None)), command


def check_launch(command: list[str]) -> None:
    _, _, package, file, *arguments = command
    assert package == 'tdm_planner'
    declared = declared_arguments(SOURCE / 'launch' / file)
    assert {argument.split(':=')[0] for argument in arguments} <= set(declared), command


def check_run(command: list[str]) -> None:
    """
    Check that the executable exists, and that it has the parameters that are set.

    Parameter files must be there, or made by an earlier command of the page. An enclave must be
    in the policy, and be that of the node.
    """
    _, _, package, executable, *arguments = command
    assert package == 'tdm_planner'
    if executable == 'tdm':
        check_tdm([executable, *arguments])
        return
    pytest.importorskip('rclpy')
    from tools.node_parameters import parameters_by_node

    found = {
        node: parameters
        for node, parameters in parameters_by_node().items()
        if node.split()[0] == executable
    }
    assert found, command
    assert not arguments or arguments[0] == '--ros-args', command
    for option, assignment in zip(arguments[1::2], arguments[2::2], strict=True):
        assert option in ('-p', '-r', '--enclave', '--params-file'), command
        if option == '--params-file':
            assert Path(assignment).is_file(), command
            continue
        if option == '--enclave':
            assert assignment in enclaves(), command
            assert f'__ns:={assignment.removesuffix(f"/{executable}")}' in arguments, command
            continue
        name, value = assignment.split(':=')
        if option == '-p' and name == 'use_sim_time':  # of every node, by rclpy
            assert isinstance(yaml.safe_load(value), bool), command
        elif option == '-p':
            specifications = [specs[name] for specs in found.values() if name in specs]
            assert specifications, command
            specifications[0].check(yaml.safe_load(value))


def check_service(command: list[str]) -> None:
    _, _, verb, name, kind = command
    assert verb == 'call', command
    assert name.rpartition('/')[2] in SERVICES, command
    assert kind == 'std_srvs/srv/Trigger'


def check_python(command: list[str]) -> None:
    """Check that the module is there, one of the package or of a tool."""
    assert command[1] == '-m', command
    assert command[2] in MODULES_OF_OTHER_PROJECTS or find_spec(command[2]), command


def check_pip(command: list[str]) -> None:
    """Check that what is installed is what the tests run with."""
    assert command[1] == 'install', command
    pinned = (SOURCE / 'constraints.txt').read_text(encoding='utf-8')
    for package in command[2:]:
        assert re.search(rf'^{re.escape(package)}==', pinned, re.MULTILINE), command


def check_program(command: list[str]) -> None:
    assert (SOURCE / command[0]).is_file(), command


CHECKS = {
    'tdm': check_tdm,
    'make': check_make,
    'cp': check_copy,
    'ros2': check_ros2,
    'export': check_export,
    'python3': check_python,
    'pip': check_pip,
    '.ci/run': check_program,
}


@pytest.mark.parametrize(
    'line',
    [
        'ros2 launch tdm_planner pendulum.launch.py plnat:=false',
        'ros2 security generate_artifacts -k keystore -p config/security/rules.xml',
        'ros2 run tdm_planner planner --ros-args -r __ns:=/robots --enclave /pendulum/planner',
        'ros2 run tdm_planner planner --ros-args --params-file my_rig.yaml',
        'ros2 run tdm_planner tdm plan pendulum --no-such-option',
        'export ROS_SECURITY_STRATEGY=Enforced',
        'python3 -m tdm_planner.setup',
        'pip install rosbag2',
        f'cp "{SHARE}/config/pendulums.yaml" my_rig.yaml',
    ],
)
def test_a_wrong_command_would_be_noticed(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    page = tmp_path / 'page.md'
    page.write_text(f'1. A step:\n\n   ```console\n   {line}\n   ```\n', encoding='utf-8')
    (tmp_path / 'keystore').mkdir()
    shutil.copytree(SOURCE / 'config', tmp_path / 'config')
    monkeypatch.chdir(tmp_path)
    (command,) = typed(page)
    with pytest.raises((AssertionError, KeyError, OSError, SystemExit, ValueError)):
        check_command(command)


@EVERY_PAGE
def test_targets_and_links_are_there(page: Path):
    text = page.read_text(encoding='utf-8')
    for target in re.findall(r'`make (\w+)', text):
        check_make(['make', target])
    for link in re.findall(r'\]\((?!https?:)([^)#\s]+)', text):
        assert (page.parent / link).exists(), link
