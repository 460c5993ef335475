# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
What README and documentation tell people to type works; what they open and quote is there.

Commands of this package are run. Those that need a ROS 2 installation, start processes that run on
(demo, nodes, recordings: other tests run these) or build are checked against what is declared.
"""

from __future__ import annotations

import ast
from configparser import ConfigParser
from pathlib import Path
import re
import shutil
from typing import Any
from xml.etree import ElementTree

from pages import blocks, name_of, PAGES, typed
import pytest
from ros_harness import SOURCE
from tdm_planner import cli
from tdm_planner.problems.base import Problem
from tdm_planner.problems.registry import problem_names
from tools.node_parameters import parameters_by_node
from tools.node_tables import declared_arguments
import yaml

EVERY_PAGE = pytest.mark.parametrize('page', PAGES, ids=name_of)
OF_OTHER_PROJECTS = {'cd', 'mkdir', 'git', 'sudo', 'rosdep', 'colcon', '.', 'source', 'pip'}
OF_OTHER_PROJECTS |= {'export', 'python3', '.ci/run'}
POLICY = ElementTree.parse(SOURCE / 'config' / 'security' / 'policy.xml')
ENCLAVES = {context.get('path') for context in POLICY.iter('context')}
SERVICES = {'plan', 'reset', 'push'}


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Results are tested here, not how soon they come on a busy machine."""
    solve = Problem.solve
    patiently = lambda problem, deadline=None, **more: solve(problem, 60.0, **more)  # noqa: E731
    monkeypatch.setattr(Problem, 'solve', patiently)


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


def check_command(command: list[str]) -> None:
    while '=' in command[0]:  # a variable, of which SROS2 has some
        command = command[1:]
    check = CHECKS.get(command[0])
    assert check is not None or command[0] in OF_OTHER_PROJECTS, command
    if check is not None:
        check(command)


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
    else:
        assert verb in ('bag', 'lifecycle', 'security'), command


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
    in the policy.
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
            assert assignment in ENCLAVES, command
        elif option == '-p' and name != 'use_sim_time':  # of every node, by rclpy
            (specification, *_) = [specs[name] for specs in found if name in specs]
            specification.check(yaml.safe_load(value))
        else:
            assert option in ('-p', '-r'), command


CHECKS = {
    'tdm': check_tdm,
    'make': check_make,
    'cp': lambda command: shutil.copy(*command[1:]),
    'ros2': check_ros2,
}


# Every message that the troubleshooting page quotes is one that the code can say.

HOLE = '\0'  # stands for what is filled in at run time


def text_of(node: ast.AST) -> str | None:
    """Return a string expression with holes for what is filled in; None for anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return ''.join(text_of(part) or HOLE for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        parts = [text_of(node.left), text_of(node.right)]
        return None if parts == [None, None] else ''.join(part or HOLE for part in parts)
    return HOLE if isinstance(node, ast.IfExp) else None


def test_quoted_messages_are_in_the_code():
    said = [' '.join((SOURCE / 'Makefile').read_text(encoding='utf-8').split())]
    for package in ('tdm_planner', 'tdm_sim'):
        for path in (SOURCE / package).rglob('*.py'):
            tree = ast.parse(path.read_text(encoding='utf-8'))
            said += [text for node in ast.walk(tree) if (text := text_of(node)) is not None]

    def can_be_said(quoted: str) -> bool:
        """Whether some string of the code holds the quoted one, dots standing for anything."""
        parts = [re.escape(part) for part in quoted.split('...')]
        inside = re.compile('.*?'.join(parts).removeprefix('.*?').removesuffix('.*?'), re.DOTALL)
        return any(inside.search(text) for text in said)

    page = (SOURCE / 'docs' / 'troubleshooting.md').read_text(encoding='utf-8')
    quoted = re.findall(r'^> `(.+)`$', page, re.MULTILINE)
    assert quoted
    assert not [text for text in quoted if not can_be_said(text)]
    assert not can_be_said('the pendulum ... fell off')
