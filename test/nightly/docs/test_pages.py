# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
What README and documentation tell people to type works.

What needs ROS 2 installed, or is started by other tests, is checked against what is declared.
"""

from collections import Counter
from configparser import ConfigParser
import itertools
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
from xml.etree import ElementTree

import pytest
from ros_harness import MODULES, NodeProcess, SOURCE
from tdm_planner import cli
from tdm_planner.problems.problem import Problem
from tdm_planner.problems.registry import problem_names, SHORT_NAMES
from tools.node_tables import declared_arguments, parameters_by_node
import yaml

FOUND = [*SOURCE.glob('*.md'), *(SOURCE / 'docs').rglob('*.md')]
PAGES = sorted(path for path in FOUND if '_build' not in path.parts)
EVERY_PAGE = pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(SOURCE)))
OF_OTHERS = {'cd', 'mkdir', 'git', 'sudo', 'rosdep', 'colcon', '.', 'source', 'pip', 'export',
             'python3', '.ci/run'}  # fmt: skip
SHARE = '$(ros2 pkg prefix --share tdm_planner)'  # commands are run in a folder like it


def blocks(page: Path, language: str) -> list[str]:
    """Return the code blocks in a language, which may stand in lists."""
    text = page.read_text(encoding='utf-8')
    found = re.findall(rf'^( *)```{language}\n(.*?)^\1```$', text, re.DOTALL | re.MULTILINE)
    return [block for _, block in found]


def typed(page: Path) -> list[list[str]]:
    """Return the words of every command of the page, without the variables before it."""
    text = ''.join(blocks(page, 'sh') + blocks(page, 'console'))
    lines = text.replace('\\\n', ' ').replace('&&', '\n').replace(SHARE, '.').splitlines()
    found = [shlex.split(line, comments=True) for line in lines]
    found = [list(itertools.dropwhile(lambda word: '=' in word, words)) for words in found]
    return [words for words in found if words]


@EVERY_PAGE
def test_examples_run_or_can_be_parsed(page):
    for block in blocks(page, 'python'):
        exec(compile(block, str(page), 'exec'), {})
    for block in blocks(page, 'yaml'):
        assert yaml.safe_load(block)
    for block in blocks(page, 'xml'):
        ElementTree.fromstring(block)
    for block in blocks(page, 'ini'):
        ConfigParser().read_string(block)


@EVERY_PAGE
def test_commands_do_what_they_say(page, tmp_path, monkeypatch):
    """In order, in a folder that has the package's parameter files."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SOURCE / 'config', tmp_path / 'config')
    solve = Problem.solve
    patiently = lambda problem, deadline=None, **more: solve(problem, 60.0, **more)  # noqa: E731
    monkeypatch.setattr(Problem, 'solve', patiently)
    for program, *words in typed(page):
        if [program, *words[:3]] == ['ros2', 'run', 'tdm_planner', 'tdm']:
            program, *words = words[2:]
        if program == 'cp':
            shutil.copy(*words)
        elif program == 'tdm':
            run_tdm(words)
        elif program == 'make':
            rules = (SOURCE / 'Makefile').read_text(encoding='utf-8')
            skipped = 2 if '-C' in words else 0
            for target in words[skipped:]:
                assert '=' in target or re.search(rf'^{target}:', rules, re.MULTILINE), target
        elif program == 'ros2':
            check_ros2(*words)
        else:
            assert program in OF_OTHERS, program


def run_tdm(words: list[str]) -> None:
    options = cli._parser().parse_args(words)  # exits for what is wrong
    runs = words[0] == 'plan' and options.problem in {*SHORT_NAMES, *problem_names()}
    if runs or (words[0] == 'report' and Path(words[1]).is_file()):
        assert cli.main(words) == 0, words
        for path in (options.output, getattr(options, 'plot', None)):
            assert path is None or path.stat().st_size > 0


def check_ros2(verb: str, *words: str) -> None:
    if verb == 'launch':
        declared = declared_arguments(SOURCE / 'launch' / words[1])
        assert {word.split(':=')[0] for word in words[2:]} <= set(declared), words
    elif verb == 'service':
        kinds = dict.fromkeys(('plan', 'reset', 'push'), 'std_srvs/srv/Trigger')
        kinds['plan_with'] = 'rcl_interfaces/srv/SetParametersAtomically'
        assert words[2] == kinds[words[1].rpartition('/')[2]], words
    elif verb == 'param':
        nodes = parameters_by_node().items()
        name = words[1].rpartition('/')[2]
        assert any(words[2] in specs for kind, specs in nodes if kind.split()[0] == name), words
    else:
        assert verb in ('run', 'bag', 'lifecycle', 'security'), words


def test_nodes_run_as_the_pages_say(ros, tmp_path, monkeypatch):
    """All at once, to save time: planners and plants that share a namespace only warn."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SOURCE / 'config', tmp_path / 'config')
    places = SOURCE / 'docs/plants', SOURCE, os.environ.get('PYTHONPATH', '')
    variables = {'PYTHONPATH': os.pathsep.join(map(str, places))}
    lines: dict[tuple[str, ...], None] = {}
    for words in itertools.chain(*map(typed, PAGES)):
        if words[0] == 'cp':
            shutil.copy(*words[1:])
        elif words[:3] == ['ros2', 'run', 'tdm_planner'] and words[3] in MODULES:
            lines[tuple(words[3:])] = None
    assert {line[0] for line in lines} == {*MODULES}
    processes: dict[str, list[NodeProcess]] = {}  # by the name of the node
    for name, *words in lines:
        spaces = [word.removeprefix('__ns:=') for word in words if word.startswith('__ns:=')]
        made = ros.run(MODULES[name], words, variables)
        processes.setdefault(f'{"".join(spaces)}/{name}', []).append(made)
    wanted = {name: len(started) for name, started in processes.items()}

    def all_there() -> bool:
        nodes = ros.node.get_node_names_and_namespaces()
        found = Counter(f'{space.rstrip("/")}/{name}' for name, space in nodes)
        return found >= Counter(wanted)

    assert ros.spin_until(all_there, 120.0), wanted
    ros.spin_for(1.0)
    for process in itertools.chain(*processes.values()):
        assert process.running, process.output
        process.process.send_signal(signal.SIGINT)
    for process in itertools.chain(*processes.values()):
        process.end_cleanly()
        found = re.findall(r'^.*(?:\[ERROR\]|\[FATAL\]).*$', process.output, re.MULTILINE)
        # A tracker that has no plan says so.
        assert all('tracker]: idle: ' in line for line in found), process.output
