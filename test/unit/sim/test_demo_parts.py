# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What demo and recorder are made of: commands, connections, speed, progress, topics."""

from __future__ import annotations

import io
from pathlib import Path
import re
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import pytest
from tdm_planner.cli import _parser
from tdm_planner.resources import config_file
from tdm_sim.demo_scene import Connections, speed_settings
from tdm_sim.progress import LiveProgress, make_progress
from tdm_sim.record_command import record_command, TopicChoice, topics_pattern

FILE = config_file('pendulum.yaml')
TRACKER, PLANT = '/pendulum/tracker', '/pendulum/pendulum_plant'


SHARED = {'/clock', '/diagnostics', '/rosout', '/tf', '/tf_static'}
OTHERS = {'/robots/robot1/odom', '/robots2/path', '/odom', '/a/robots/odom', '/diagnostics_agg',
          '/hall/a/odom', '/hall/abc'}  # fmt: skip


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
def test_nodes_tell_in_their_diagnostics_whether_they_are_connected(node, figures, connected):

    def told(**shown: str) -> Any:
        values = [KeyValue(key=key, value=value) for key, value in shown.items()]
        status = DiagnosticStatus(name=f'{node}: something', values=values)
        return DiagnosticArray(status=[status])

    connections = Connections()
    ask = connections.tracker if node == TRACKER else connections.plant
    assert not ask(node)
    connections.take(told(**figures))
    assert ask(node) == connected
    assert not ask('/other/node')
    connections.take(told())  # the newest word counts
    assert not ask(node)


def test_at_another_speed_what_covers_real_time_is_longer_and_rates_are_lower() -> None:
    for node in ('planner', 'tracker', 'pendulum_plant', 'robot_plant', 'plant'):
        assert speed_settings(node, FILE, 1.0, drives_clock=False) == {}
    assert speed_settings('planner', FILE, 4.0, drives_clock=False) == {
        'use_sim_time': True,
        'start.delay': 4.0,
        'start.max_age': 2.0,
        'replan.delay': 0.6,
    }
    tracker = speed_settings('tracker', FILE, 4.0, drives_clock=False, rates=2.0)
    assert (tracker['rate'], tracker['state_timeout']) == (100.0, pytest.approx(0.4))
    assert speed_settings('pendulum_plant', FILE, 4.0, drives_clock=True, rates=2.0) == {
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


@pytest.mark.parametrize(
    ('quiet', 'lines'), [(False, r'\[ *\d+\.\d s\] first\n\[b\]\n'), (True, '')]
)
def test_piped_there_are_plain_lines_and_when_quiet_none(capsys, quiet, lines):
    with make_progress(quiet) as progress:
        progress.phase('first')
        progress.update('live only')
        progress.line('[b]')
    assert re.fullmatch(lines, capsys.readouterr().out)


class Terminal(io.StringIO):
    """What is written to a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_gets_a_live_line(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.setenv('COLUMNS', '100')
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
    for words in ('live only', 'first [part]', '\x1b[', 'done'):
        assert words in terminal.getvalue()


@pytest.mark.parametrize(
    ('namespace', 'wanted'),
    [
        *((name, {'/robots/robot1/odom'}) for name in ('robots', '/robots', '/robots/')),
        ('hall/a', {'/hall/a/odom'}),
        ('/', OTHERS),
    ],
)
def test_a_namespace_is_recorded_with_what_belongs_to_none_alike_by_both_recorders(
    namespace, wanted
):
    choice, pattern = TopicChoice(namespace=namespace), re.compile(topics_pattern(namespace))
    for topic in SHARED | OTHERS:
        assert choice.wants(topic) == (topic in SHARED | wanted), topic
        assert bool(pattern.search(topic)) == choice.wants(topic), topic
    assert not choice.wants('/robots/_hidden/odom')


def test_topics_are_recorded_by_name_or_all() -> None:
    choice = TopicChoice(frozenset({'/chosen', '/_hidden'}))
    both = TopicChoice(frozenset({'/chosen'}), 'robots')
    asked = ('/chosen', '/_hidden', '/robots/path', '/tf', '/other', '/x/_y')
    for chosen, wanted in ((choice, '110000'), (both, '101100'), (TopicChoice(), '101110')):
        assert [chosen.wants(topic) for topic in asked] == [flag == '1' for flag in wanted]


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where ROS 2 looks for packages."""
    (tmp_path / 'share/ament_index/resource_index/packages').mkdir(parents=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    return tmp_path


def test_ros2_bag_records_where_it_is_installed(prefix: Path) -> None:
    (prefix / 'share/ament_index/resource_index/packages/ros2bag').touch()
    command = record_command('hall/a', 'my_bag')
    assert command[:3] == ['ros2', 'bag', 'record']
    assert command[3:] == ['--output', 'my_bag', '--regex', topics_pattern('hall/a')]
    assert record_command('hall/a', 'my_bag', use_sim_time=True) == [*command, '--use-sim-time']


def test_the_installed_tdm_records_elsewhere(prefix: Path) -> None:
    """Of a workspace that colcon built; its Python need not be this one."""
    (prefix / 'share/ament_index/resource_index/packages/tdm_planner').touch()
    (prefix / 'lib/tdm_planner').mkdir(parents=True)
    (prefix / 'lib/tdm_planner/tdm').touch(0o755)
    program, *words = record_command('hall/a', 'my_bag')
    assert program == str(prefix / 'lib/tdm_planner/tdm')
    options = _parser().parse_args(words)
    assert (options.output, options.namespace) == (Path('my_bag'), '/hall/a')
    assert record_command('hall/a', 'my_bag', use_sim_time=True) == [program, *words]
    for namespace, name in (('/hall/a', 'hall_a'), ('', 'tdm')):
        words = record_command(namespace)
        folder = words[words.index('--output') + 1]
        assert re.fullmatch(rf'{name}_\d{{4}}(_\d\d){{2}}-\d\d(_\d\d){{2}}', folder)
