# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What the demo is made of: commands read, nodes that found each other, speed, progress."""

from __future__ import annotations

from collections.abc import Mapping
import math
import os
from pathlib import Path
import pty
import sys
from types import SimpleNamespace
from typing import Any

import pytest
from tdm_planner.resources import config_file
from tdm_sim.commands import MalformedCommand, read_joint
from tdm_sim.demo_speed import speed_settings
from tdm_sim.progress import LiveProgress, make_progress

FILE = config_file('pendulum.yaml')
TRACKER, PLANT = '/pendulum/tracker', '/pendulum/pendulum_plant'


def joints(name: list[str], effort: list[float]) -> SimpleNamespace:
    return SimpleNamespace(name=name, effort=effort, velocity=[])


def test_joints_are_found_by_name() -> None:
    command = joints(['pendulum', 'disk'], [0.5, 0.01])
    assert read_joint(command, 'disk', 'effort') == 0.01
    assert read_joint(command, 'pendulum', 'effort') == 0.5


@pytest.mark.parametrize(
    ('command', 'words'),
    [
        (joints([], []), "must name joint 'disk' once, but its names are: none"),
        (joints(['arm'], [0.0]), "must name joint 'disk' once, but its names are: arm"),
        (joints(['disk', 'disk'], [0.0, 1.0]), "must name joint 'disk' once"),
        (joints(['disk'], []), "'effort' has 0 values for 1 named joint"),
        (joints(['disk'], [0.0, 1.0]), "'effort' has 2 values for 1 named joint"),
        (joints(['disk'], [math.nan]), "effort of joint 'disk' is nan"),
        (joints(['disk'], [-math.inf]), "effort of joint 'disk' is -inf"),
    ],
)
def test_malformed_commands_say_why(command: SimpleNamespace, words: str) -> None:
    with pytest.raises(MalformedCommand, match=words):
        read_joint(command, 'disk', 'effort')


@pytest.mark.parametrize(
    ('node', 'figures', 'connected'),
    [
        (TRACKER, {'state age [s]': '0.004', 'planners': '1'}, True),
        (TRACKER, {'state age [s]': 'inf', 'planners': '1'}, False),
        (TRACKER, {'state age [s]': '0.004', 'planners': '0'}, False),
        (TRACKER, {'state age [s]': '?', 'planners': '1'}, False),
        (PLANT, {'commands accepted': '0'}, False),
        (PLANT, {'commands accepted': '1'}, True),
    ],
)
def test_nodes_tell_in_their_diagnostics_whether_they_are_connected(
    node: str, figures: Mapping[str, str], connected: bool
) -> None:
    msg = pytest.importorskip('diagnostic_msgs.msg')
    from tdm_sim.connections import Connections

    def told(**shown: str) -> Any:
        values = [msg.KeyValue(key=key, value=value) for key, value in shown.items()]
        status = msg.DiagnosticStatus(name=f'{node}: something', values=values)
        return msg.DiagnosticArray(status=[status])

    connections = Connections()
    ask = connections.tracker if node == TRACKER else connections.plant
    assert not ask(node)
    connections.take(told(**figures))
    assert ask(node) == connected
    assert not ask('/other/node')
    connections.take(told())  # the newest word counts
    assert not ask(node)


def test_at_real_time_nothing_is_changed() -> None:
    for node in ('planner', 'tracker', 'pendulum_plant', 'robot_plant'):
        assert speed_settings(node, FILE, 1.0, drives_clock=False) == {}


def test_faster_what_covers_real_time_is_longer_and_rates_are_lower() -> None:
    assert speed_settings('planner', FILE, 4.0, drives_clock=False) == {
        'use_sim_time': True,
        'start.delay': 4.0,
        'start.max_age': 2.0,
        'replan.delay': 0.6,
    }
    tracker = speed_settings('tracker', FILE, 4.0, drives_clock=False, rates=2.0)
    assert tracker['rate'] == 100.0
    assert tracker['state_timeout'] == pytest.approx(0.4)
    plant = speed_settings('pendulum_plant', FILE, 4.0, drives_clock=True, rates=2.0)
    assert plant == {
        'use_sim_time': False,
        'publish_clock': True,
        'real_time_factor': 4.0,
        'clock_followers': ['joint_command'],
        'command_timeout': pytest.approx(0.4),
        'rate': 100.0,
    }
    # slower, nothing is shortened
    assert speed_settings('planner', FILE, 0.5, drives_clock=False)['start.delay'] == 1.0
    assert speed_settings('tracker', FILE, 0.5, drives_clock=False)['rate'] == 200.0


def test_the_parameter_file_is_heeded_and_ranges_are_kept(tmp_path: Path) -> None:
    file = tmp_path / 'own.yaml'
    file.write_text(
        '/**/planner:\n  ros__parameters:\n    start: {delay: 2}\n    replan: {delay: 5.0}\n'
        '/**/tracker:\n  ros__parameters:\n    rate: 50\n'
    )
    planner = speed_settings('planner', file, 4.0, drives_clock=False)
    assert planner['start.delay'] == 8.0
    assert planner['replan.delay'] == 10.0  # the most that is allowed
    assert speed_settings('tracker', file, 4.0, drives_clock=False)['rate'] == 12.5
    plant = speed_settings('pendulum_plant', file, 4.0, drives_clock=True)
    assert plant['rate'] == 50.0  # the default's quarter: the file says nothing of the plant


@pytest.mark.parametrize(('quiet', 'shown'), [(False, ['[  0.0 s] first', '[b]']), (True, [])])
def test_piped_there_are_plain_lines_and_when_quiet_none(
    capsys: pytest.CaptureFixture[str], quiet: bool, shown: list[str]
) -> None:
    with make_progress(quiet) as progress:
        progress.phase('first')
        progress.update('live only')
        progress.line('[b]')
    assert capsys.readouterr().out.splitlines() == shown


def test_a_terminal_gets_a_live_line(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.setenv('COLUMNS', '100')
    with os.fdopen(theirs, 'w') as terminal:
        monkeypatch.setattr(sys, 'stdout', terminal)
        assert not isinstance(make_progress(quiet=True), LiveProgress)
        progress = make_progress()
        assert isinstance(progress, LiveProgress)
        with progress:
            progress.phase('first [part]')
            progress.update('live only')
            progress._bars.refresh()
        progress.line('done')
        # an error ends the live line
        with pytest.raises(ZeroDivisionError), progress:
            progress.phase(f'{1 // 0}')
        assert not progress._bars.live.is_started
        terminal.flush()
        sent = os.read(ours, 65536).decode()
    os.close(ours)
    for words in ('live only', 'first [part]', '\x1b[', 'done'):
        assert words in sent
