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

from configparser import ConfigParser
from importlib.util import find_spec
from pathlib import Path
import re
import shutil
from typing import Any
from xml.etree import ElementTree

from pages import blocks, name_of, PAGES, typed
import pytest
from ros_harness import SOURCE
from tdm_planner import cli
from tdm_planner.problems.base import Problem, Solution
from tdm_planner.problems.registry import problem_names
from tools.node_parameters import parameters_by_node
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
def test_commands_do_what_they_say(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In order, in a folder that has the package's parameter files."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SOURCE / 'config', tmp_path / 'config')
    for command in typed(page):
        check_command(command)


@EVERY_PAGE
def test_targets_and_links_are_there(page: Path):
    text = page.read_text(encoding='utf-8')
    for target in re.findall(r'`make (\w+)', text):
        check_make(['make', target])
    for link in re.findall(r'\]\((?!https?:)([^)#\s]+)', text):
        assert (page.parent / link).exists(), link


def test_wrong_commands_would_be_noticed():
    for line in (
        'ros2 launch tdm_planner pendulum.launch.py plnat:=false',
        'ros2 run tdm_planner planner --ros-args -r __ns:=/robots --enclave /pendulum/planner',
        'ros2 run tdm_planner planner --ros-args --params-file my_rig.yaml',
        'tdm plan pendulum --no-such-option',
        'export ROS_SECURITY_STRATEGY=Enforced',
        'python3 -m tdm_planner.setup',
    ):
        with pytest.raises((AssertionError, KeyError, SystemExit)):
            check_command(line.split())


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
        check_enclave(value)


def check_enclave(path: str) -> None:
    policy = ElementTree.parse(SOURCE / 'config' / 'security' / 'policy.xml')
    assert path in {context.get('path') for context in policy.iter('context')}


def check_tdm(command: list[str]) -> None:
    options = cli._parser().parse_args(command[1:])  # exits for what is wrong
    runs = command[1] == 'plan' and options.problem in {*cli.SHORT_NAMES, *problem_names()}
    if runs or (command[1] == 'report' and Path(command[2]).is_file()):
        assert cli.main(command[1:]) == 0, command
        for path in (options.output, getattr(options, 'plot', None)):
            assert path is None or path.stat().st_size > 0


def check_make(command: list[str]) -> None:
    makefile = (SOURCE / 'Makefile').read_text(encoding='utf-8')
    first = command.index('-C') + 2 if '-C' in command else 1
    for target in command[first:]:
        if '=' not in target:
            assert re.search(rf'^{target}:', makefile, re.MULTILINE), target


def check_ros2(command: list[str]) -> None:
    _, verb, *words = command
    if verb == 'launch':
        declared = declared_arguments(SOURCE / 'launch' / words[1])
        assert {word.split(':=')[0] for word in words[2:]} <= set(declared), command
    elif verb == 'run':
        check_run(words[1:])
    elif verb == 'service':
        assert words[1].rpartition('/')[2] in SERVICES, command
        assert words[2] == 'std_srvs/srv/Trigger', command
    elif verb == 'param':
        assert any(words[2] in names for names in parameters_of(words[1])), command
    elif verb == 'lifecycle':
        assert words[1].rpartition('/')[2] in ('planner', 'tracker'), command
        assert words[2] in ('configure', 'activate', 'deactivate', 'cleanup', 'shutdown'), command
    else:
        assert verb in ('bag', 'security'), command


def parameters_of(node: str) -> list[Any]:
    """Return the specifications of every kind of a node, of which it has several."""
    name = node.rpartition('/')[2]
    found = [specs for kind, specs in parameters_by_node().items() if kind.split()[0] == name]
    assert found, node
    return found


def check_run(command: list[str]) -> None:
    """
    Check that the executable exists, and that it has the parameters that are set.

    Parameter files must be there, or made by an earlier command of the page. An enclave must be
    in the policy, and be that of the node.
    """
    executable, *arguments = command
    if executable == 'tdm':
        check_tdm(command)
        return
    found = parameters_of(executable)
    assert not arguments or arguments[0] == '--ros-args', command
    for option, assignment in zip(arguments[1::2], arguments[2::2], strict=True):
        name, _, value = assignment.partition(':=')
        if option == '--params-file':
            assert Path(assignment).is_file(), command
        elif option == '--enclave':
            check_enclave(assignment)
            assert f'__ns:={assignment.removesuffix(f"/{executable}")}' in arguments, command
        elif option == '-p' and name != 'use_sim_time':  # of every node, by rclpy
            (specification, *_) = [specs[name] for specs in found if name in specs]
            specification.check(yaml.safe_load(value))
        else:
            assert option in ('-p', '-r'), command


def check_python(command: list[str]) -> None:
    """Check that the module is there, one of the package or of a tool."""
    assert command[1] == '-m', command
    assert command[2] in MODULES_OF_OTHER_PROJECTS or find_spec(command[2]), command


def check_pip(command: list[str]) -> None:
    """Check that what is installed is what the tests run with."""
    pinned = (SOURCE / 'constraints.txt').read_text(encoding='utf-8')
    for package in command[2:]:
        assert re.search(rf'^{re.escape(package)}==', pinned, re.MULTILINE), command


CHECKS = {
    'tdm': check_tdm,
    'make': check_make,
    'cp': lambda command: shutil.copy(*command[1:]),
    'ros2': check_ros2,
    'export': lambda command: check_variable(command[1]),
    'python3': check_python,
    'pip': check_pip,
    '.ci/run': lambda command: (SOURCE / command[0]).read_text(encoding='utf-8'),
}
