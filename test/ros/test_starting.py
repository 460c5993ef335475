# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A signal ends a node with code 0 and without a word of Python, however early it comes."""

from __future__ import annotations

from pathlib import Path
import signal
import time
from typing import Any

import pytest
from ros_harness import NodeProcess, Ros
from tdm_planner import starting

MODULES: dict[str, dict[str, Any]] = {
    'tdm_planner.nodes.planner': {},
    'tdm_planner.nodes.tracker': {'kind': 'robot'},
    'tdm_sim.pendulum_plant': {},
}
DELAYS = (0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.1)  # s after the first import


def begun(process: NodeProcess) -> bool:
    """Whether the package has been imported: SIGTERM is handled, which Python does not do."""
    status = Path(f'/proc/{process.process.pid}/status')
    if not status.exists():
        return False
    (line,) = (line for line in status.read_text().splitlines() if line.startswith('SigCgt'))
    return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


@pytest.mark.parametrize('module', MODULES)
def test_a_signal_while_a_node_starts_ends_it_cleanly(ros: Ros, module: str) -> None:
    for k, delay in enumerate(DELAYS):
        process = ros.start(module, MODULES[module])
        end = time.monotonic() + 20.0
        while not begun(process):
            assert process.running, process.output
            assert time.monotonic() < end
            time.sleep(0.005)
        time.sleep(delay)
        number = (signal.SIGINT, signal.SIGTERM)[k % 2]
        assert process.end(number) == 0, (delay, number, process.output)
        assert 'Traceback' not in process.output, process.output
        assert 'fatal' not in process.output, process.output


@pytest.mark.parametrize(
    ('words', 'command'),
    [
        (
            ['python', '-m', 'tdm_planner.cli', 'record', '-o', 'bag'],
            ['tdm', 'record', '-o', 'bag'],
        ),
        (['python', '/opt/bin/tdm', 'plan', 'pendulum'], ['tdm', 'plan', 'pendulum']),
        (['python', '/opt/bin/other', 'record'], []),
        (['python', '-m', 'pytest', 'record'], []),
        (['python', '-c', 'import tdm_planner'], []),
    ],
)
def test_commands_are_told_from_other_processes(
    words: list[str], command: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('sys.orig_argv', words)
    monkeypatch.setattr('sys.argv', words[1:] if words[1][0] == '/' else ['-m'])
    assert starting.command() == command


@pytest.mark.parametrize(
    ('words', 'node'),
    [
        (['python', '-m', 'tdm_planner.nodes.planner', '--ros-args'], True),
        (['python', '-X', 'dev', '-m', 'tdm_sim.robot_plant'], True),
        (['python', '/opt/lib/tdm_planner/tracker'], True),
        (['python', '/opt/bin/tdm', 'plan'], False),
        (['python', '-m', 'pytest', 'planner'], False),
        (['python', '-m', 'nav.planner'], False),
        (['python', '-c', 'import tdm_planner'], False),
    ],
)
def test_only_the_processes_of_nodes_are_touched(
    words: list[str], node: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('sys.orig_argv', words)
    monkeypatch.setattr('sys.argv', words[1:] if words[1][0] == '/' else ['-m'])
    assert starting.is_node() is node
