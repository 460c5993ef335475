# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""Recorder and demo: what a kill and a full disk leave; topics, commands, lines."""

from contextlib import nullcontext, suppress
from importlib.util import find_spec
import io
import os
from pathlib import Path
import re
import resource
import shutil
import signal
import sqlite3
import sys
from types import SimpleNamespace
from unittest.mock import Mock

from bag_contents import fill, metadata, numbers, read_with_mcap, read_with_rosbags
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
import pytest

if find_spec('rclpy') is None:
    pytest.skip('messages are made by rclpy', allow_module_level=True)

from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rclpy.type_hash import TypeHash
from rosbags.typesys import get_typestore, Stores
from std_msgs.msg import String
from tdm_planner.cli import main
from tdm_planner.exceptions import InvalidProblem
from tdm_planner.parameter_files import config_file
from tdm_planner.plan_files import UnusableFile
from tdm_planner.robot_nodes import Part
from tdm_planner.starting import Interrupted
from tdm_sim import demo, recorder
from tdm_sim.bag_writer import BagWriter, definition_and_hash, MOST_OPEN
from tdm_sim.demo import DemoFailed, NamespaceTaken
from tdm_sim.processes import make_scene, ProcessFailed, speed_settings
from tdm_sim.progress import Progress as Lines
from tdm_sim.recorder import (
    Figures,
    IncompleteRecording,
    is_wanted,
    message_class,
    record,
    RecordingError,
)

HASH = TypeHash(version=1, value=bytes(32))
ENDPOINT = SimpleNamespace(qos_profile=QoSProfile(depth=1), topic_type_hash=None)
DONE = Figures(61.2, {'/a': 3, '/b': 4}, dropped=2, size=1_250_000, rate=99.6)
TRACKER, PLANT = '/pendulum/tracker', '/pendulum/pendulum_plant'
BOTH = '/*/planner: {ros__parameters: {method: smooth}}\n/*/tracker: {ros__parameters: {a: '
SHARED = {'/clock', '/diagnostics', '/rosout', '/tf', '/tf_static'}
OTHERS = {'/robots/robot1/odom', '/robots2/path', '/odom', '/a/robots/odom', '/diagnostics_agg',
          '/hall/a/odom', '/hall/abc'}  # fmt: skip
SPACES = [(name, {'/robots/robot1/odom'}) for name in ('robots', '/robots', '/robots/')]
SPACES += [('hall/a', {'/hall/a/odom'}), ('/', OTHERS)]


def written(writer: BagWriter, most: int, size: int) -> int:
    """Write messages until one cannot be, at most `most`; how many could."""
    connection = writer.add_topic('/t', 'std_msgs/msg/String', [ENDPOINT])
    for k in range(most):
        text = f'{k:06d}' + 'x' * size
        writer.write(connection, 10**9 + k, serialize_message(String(data=text)))
        if writer.failure:
            return k
    return most


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('room', [2_000_000, -1])
def test_a_bag_ends_whole_before_the_disk_is_full(tmp_path, monkeypatch, storage, room) -> None:
    """Also if it was too full to begin."""
    bag = tmp_path / 'bag'
    fill(monkeypatch, room)
    with BagWriter(bag, storage) as writer:
        count = written(writer, 10_000, 1000)
        assert (1500 < count < 3000) == (room > 0)
        assert 'No space left on device' in writer.failure
        writer.write(None, 0, b'left out')
    found = numbers(read_with_rosbags(bag)['/t'])
    assert found == list(range(count + 1))
    assert metadata(bag)['message_count'] == len(found)
    if storage == 'mcap':
        assert numbers(read_with_mcap(bag)['/t']) == found


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bag_that_can_suddenly_not_be_written_is_left_as_by_a_kill(tmp_path, storage):
    """A limit of the file's size says so to the process, as other faults of a disk."""
    bag, limits = tmp_path / 'bag', resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with BagWriter(bag, storage) as writer:
            resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, limits[1]))
            count = written(writer, 10_000, 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert writer.failure.endswith('; it has no index')
    assert count - MOST_OPEN / 1000 < messages_after_a_kill(bag) <= count + 1


def messages_after_a_kill(bag: Path) -> int:
    if (database := bag / f'{bag.name}.db3').exists():
        connection = sqlite3.connect(database)
        ((seen,),) = connection.execute('SELECT count(*) FROM messages')
        connection.close()
        return int(seen)
    seen = 0
    with (bag / f'{bag.name}.mcap').open('rb') as stream, suppress(EndOfFile):
        for item in StreamReader(stream).records:
            seen += isinstance(item, Message)
    return seen


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_recorder_that_is_killed_leaves_what_was_completed(tmp_path, storage, monkeypatch):
    """What is on disk after `keep`, before the bag is closed, is what a kill leaves."""
    monkeypatch.setattr('tdm_sim.bag_writer.LONGEST_OPEN', 0.0)
    bag, copy = tmp_path / 'bag', tmp_path / 'killed' / 'bag'
    with BagWriter(tmp_path / 'much') as writer:  # however much comes within a second
        assert written(writer, 1500, 1000) == 1500
        assert 1_500_000 - (writer.path / 'much.mcap').stat().st_size < MOST_OPEN
    with BagWriter(bag, storage) as writer:
        assert written(writer, 50, 10) == 50
        writer.keep()
        shutil.copytree(bag, copy)
    assert messages_after_a_kill(copy) == 50


def test_folders_and_storages_that_cannot_be_are_refused(tmp_path, capsys):
    (tmp_path / 'precious').write_text('data')
    for bag, storage, words in (
        (tmp_path, 'mcap', 'exists already'),
        (tmp_path / 'precious' / 'bag', 'mcap', 'cannot be made: Not a directory'),
        (tmp_path / 'bag', 'tape', "'tape' is not allowed: must be one of mcap, sqlite"),
    ):
        with pytest.raises(RecordingError, match=words):
            record(bag, storage=storage)
    assert main(['record', '-o', str(tmp_path)]) == 2
    told = f"tdm: RECORDING: the folder '{tmp_path}' exists already: choose another or remove it\n"
    assert capsys.readouterr() == ('', told)
    assert [path.name for path in tmp_path.iterdir()] == ['precious']


@pytest.mark.parametrize('name', ['sensor_msgs/msg/JointState', 'nav_msgs/msg/Odometry'])
def test_definitions_have_their_members_and_the_hash_of_the_wire(name: str) -> None:
    standard, type_hash = definition_and_hash(name, None)
    assert get_typestore(Stores.ROS2_JAZZY).hash_rihs01(name) == type_hash
    assert definition_and_hash(name, HASH) == (standard, str(HASH))
    for member in ('std_msgs/Header', 'builtin_interfaces/Time'):
        assert f'MSG: {member}' in standard
    for absent in ('nowhere_msgs/msg/Thing', 'std_msgs/msg/Thing'):
        with pytest.raises(InvalidProblem, match=f"its message type '{absent}' is not installed"):
            message_class(absent)
        with pytest.raises(InvalidProblem, match=f"its message type '{absent}' does not come"):
            definition_and_hash(absent, None)


@pytest.mark.parametrize('quiet', [False, True])
def test_the_command_tells_how_far_it_is_and_how_it_ended(monkeypatch, capsys, quiet):
    failures = IncompleteRecording('full'), RecordingError('x')
    monkeypatch.setattr(recorder, 'record', Mock(side_effect=[DONE, *failures]))
    assert str(DONE) == '61 s, 7 messages on 2 topics, 100/s, 1.2 MB, 2 dropped'
    command = ['record', '-o', 'bag', *['-q'] * quiet]
    assert main(command) == 0
    shown = capsys.readouterr().out
    for words in ('written to bag, 2 dropped', '       4  /b'):
        assert (words in shown) != quiet
    for failure, code in zip(failures, (1, 2), strict=True):
        assert main(command) == code
        assert capsys.readouterr().err == f'tdm: RECORDING: {failure}\n'


def test_at_another_speed_what_covers_real_time_is_longer_and_rates_are_lower() -> None:
    def settings(node: str, speed: float, **more):
        return speed_settings(Part(node, '/pendulum'), config_file('pendulum.yaml'), speed, **more)

    for node in ('planner', 'tracker', 'pendulum_plant', 'robot_plant', 'plant'):
        assert settings(node, 1.0) == {}
    longer = {'start.delay': 4.0, 'start.max_age': 2.0, 'replan.delay': 0.6}
    assert settings('planner', 4.0) == {'use_sim_time': True, **longer}
    tracker = settings('tracker', 4.0, rates=2.0)
    assert (tracker['rate'], tracker['state_timeout']) == (100.0, pytest.approx(0.4))
    plant = {'use_sim_time': False, 'publish_clock': True, 'real_time_factor': 4.0, 'rate': 100.0}
    plant |= {'clock_followers': ['joint_command'], 'command_timeout': pytest.approx(0.4)}
    assert settings('pendulum_plant', 4.0, followers=['joint_command'], rates=2.0) == plant
    assert settings('planner', 0.5)['start.delay'] == 1.0
    assert settings('tracker', 0.5)['rate'] == 200.0


def test_piped_there_are_plain_lines_and_when_quiet_none(capsys):
    for quiet, lines in ((False, r'\[ *\d+\.\d s\] first\n\[b\]\n'), (True, '')):
        with Lines(quiet) as progress:
            progress.phase('first')
            progress.update('live only')
            progress.line('[b]')
        assert re.fullmatch(lines, capsys.readouterr().out)


def test_a_terminal_gets_a_live_line(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, 'isatty', lambda: True)
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.setenv('COLUMNS', '100')
    monkeypatch.setattr(sys, 'stdout', terminal)
    assert not Lines(quiet=True).live
    progress = Lines()
    assert progress.live
    with progress:
        progress.phase('first [part]')
        progress.update('live only')
        progress._bars.refresh()
    progress.line('done')
    with pytest.raises(ZeroDivisionError), progress:
        progress.phase(f'{1 // 0}')
    assert not progress._bars.live.is_started
    for words in ('live only', 'first [part]', '\x1b[', 'done'):
        assert words in terminal.getvalue()


@pytest.mark.parametrize(('namespace', 'wanted'), SPACES)
def test_a_namespace_is_recorded_with_what_belongs_to_none(namespace, wanted):
    for topic in SHARED | OTHERS:
        assert is_wanted(topic, namespace=namespace) == (topic in SHARED | wanted), topic
    assert not is_wanted('/robots/_hidden/odom', namespace=namespace)
    named, both = ({'/chosen', '/_hidden'}, None), ({'/chosen'}, 'robots')
    asked = ('/chosen', '/_hidden', '/robots/path', '/tf', '/other', '/x/_y')
    for chosen, wanted in ((named, '110000'), (both, '101100'), (((), None), '101110')):
        assert [is_wanted(topic, *chosen) for topic in asked] == [flag == '1' for flag in wanted]


@pytest.mark.parametrize(
    ('error', 'code'),
    [
        (DemoFailed('no plan: it is too weak'), 1),
        (ProcessFailed('the planner ended with exit code 1'), 1),
        (NamespaceTaken('nodes run in it already'), 2),
        (InvalidProblem('there is no such problem'), 2),
    ],
)
def test_a_demo_that_fails_is_told_from_one_that_has_not_begun(monkeypatch, capsys, error, code):
    monkeypatch.setattr(demo, 'run_demo', Mock(side_effect=error))
    assert main(['demo', 'pendulum']) == code
    assert capsys.readouterr().err == f'tdm: {error.code}: {error}\n'


def test_a_signal_before_a_recording_has_begun_is_told_from_one_afterwards(monkeypatch, tmp_path):
    words = ['record', '-o', str(tmp_path / 'bag')]
    monkeypatch.setattr(recorder, 'record', Mock(side_effect=Interrupted(signal.SIGINT)))
    assert main(words) == 130
    monkeypatch.setattr(recorder, 'record', Mock(return_value=DONE))
    monkeypatch.setattr(Lines, 'line', Mock(side_effect=Interrupted(signal.SIGINT)))
    assert main(words) == 0


@pytest.mark.parametrize('foreign', ['', 'log/notes.txt', 'bag/ways', 'plan.json'])
def test_a_demo_clears_what_a_demo_has_left_and_nothing_else(foreign, tmp_path):
    """A link stays, as other files do; so does a plan where no demo has begun."""
    left = ['log/recorder.log', 'bag/bag_0.mcap', 'bag/metadata.yaml', 'report.html']
    for name in [foreign or 'plan.json', *left]:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    if foreign == 'bag/ways':
        (tmp_path / foreign).unlink()
        (tmp_path / foreign).symlink_to('/')
    if foreign == 'plan.json':
        (tmp_path / 'log/recorder.log').unlink()
    before = set(tmp_path.rglob('*'))
    with pytest.raises(UnusableFile, match='holds') if foreign else nullcontext():
        demo._prepare_folder(tmp_path)
    assert set(tmp_path.rglob('*')) == (before if foreign else {tmp_path / 'log'})


def test_a_parameter_file_for_another_namespace_is_refused(tmp_path):
    file = tmp_path / 'rig.yaml'
    sections = {'/rig/planner': True, '/cart/planner': False, '/**/plant': False}
    for section, refused in sections.items():
        file.write_text(f'{section}: {{ros__parameters: {{limit: 3.0}}}}\n')
        with pytest.raises(InvalidProblem, match='/cart/planner') if refused else nullcontext():
            scene = make_scene('stated:Cart', file)
            assert scene.problem.limit == (3.0 if 'planner' in section else 10.0)


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('limits:\n  torque: 0.05\n', "line 2; parameters must stand below the name of a node, '"),
        (f'{BOTH}[1, 2.5]}}}}\n', 'at line_num 2; the numbers of a list must all have a decimal'),
        (f'{BOTH}[[1], [2]]}}}}\n', 'cannot be key at line 2'),
    ],
)
def test_a_parameter_file_that_nodes_cannot_read_is_refused_before_they_start(
    text, told, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'p.yaml').write_text(text)
    for command in ('demo', 'live'):
        assert main([command, 'pendulum', '--params', 'p.yaml', '-o', 'out']) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert line.startswith("tdm: INVALID_PROBLEM: nodes cannot read the file 'p.yaml': ")
        assert told in line
    assert not (tmp_path / 'out').exists()


def test_output_that_nobody_reads_does_not_end_a_command(tmp_path, monkeypatch, capsys):
    """As behind `| head`."""
    reader, writer = os.pipe()
    os.close(reader)
    monkeypatch.setattr(sys, 'stdout', os.fdopen(writer, 'w'))
    assert main(['check', 'double_integrator:DoubleIntegrator']) == 0
    file = tmp_path / 'plan.json'
    assert main(['plan', 'double_integrator:DoubleIntegrator', '-o', str(file)]) == 0
    assert file.is_file()
    assert capsys.readouterr().err == ''
