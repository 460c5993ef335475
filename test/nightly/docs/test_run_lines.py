# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Every `ros2 run` of a node that pages show, as a real process: it runs, and Ctrl-C ends it."""

from __future__ import annotations

from collections import Counter
import itertools
import os
from pathlib import Path
import re
import shutil
import signal
import time

from pages import install_own_plant, PAGES, typed
import pytest
from ros_harness import MODULES, NodeProcess, Ros, SOURCE

WHILE = 1.0  # s that each runs, at least
RUN = ['ros2', 'run', 'tdm_planner']
Line = tuple[str, ...]  # an executable and its arguments


def run_lines() -> list[Line]:
    """Return what is run by the pages, once each."""
    found: dict[Line, None] = {}
    for page in PAGES:
        for words in typed(page):
            while '=' in words[0]:  # a variable, of which SROS2 has some
                words = words[1:]
            if words[:3] == RUN and words[3] in MODULES:
                found[tuple(words[3:])] = None
    return list(found)


def full_name(line: Line) -> str:
    """Return the name that the node of a line has."""
    spaces = [word.removeprefix('__ns:=') for word in line if word.startswith('__ns:=')]
    return f'{"".join(spaces)}/{line[0]}'


def copy_what_pages_copy(folder: Path) -> None:
    """Make the parameter files that pages have their readers make."""
    shutil.copytree(SOURCE / 'config', folder / 'config')
    for page in PAGES:
        for words in typed(page):
            if words[0] == 'cp':
                shutil.copy(folder / words[1], folder / words[2])


def test_nodes_run_as_the_pages_say(
    ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All at once, to save time: planners and plants that share a namespace only warn."""
    copy_what_pages_copy(tmp_path)
    install_own_plant(tmp_path)
    monkeypatch.chdir(tmp_path)
    path = {'PYTHONPATH': os.pathsep.join([str(tmp_path), ros.environment['PYTHONPATH']])}
    processes: dict[str, list[NodeProcess]] = {}  # by the name of the node
    assert {line[0] for line in run_lines()} == {*MODULES}
    for line in run_lines():
        process = ros.run(MODULES[line[0]], list(line[1:]), path)
        processes.setdefault(full_name(line), []).append(process)
    seen: dict[str, float] = {}  # instant at which all of that name were there
    running = set(processes)

    def all_have_run() -> bool:
        now = time.monotonic()
        found = Counter(
            f'{space.rstrip("/")}/{name}'
            for name, space in ros.node.get_node_names_and_namespaces()
        )
        for name in sorted(running):
            if name not in seen and found[name] >= len(processes[name]):
                seen[name] = now
            elif now - seen.get(name, now) > WHILE:
                running.remove(name)
                for process in processes[name]:
                    assert process.running, process.output
                    process.process.send_signal(signal.SIGINT)
        return not running

    assert ros.spin_until(all_have_run, 120.0), running
    for process in itertools.chain(*processes.values()):
        process.end_cleanly()
        found = re.findall(r'^.*(?:\[ERROR\]|\[FATAL\]).*$', process.output, re.MULTILINE)
        # A tracker that has no plant says so.
        assert all('tracker]: idle: ' in line for line in found), process.output
