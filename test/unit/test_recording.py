# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""What a recorder writes survives a kill and a full disk; the command says how it ended."""

from __future__ import annotations

from contextlib import suppress
import errno
from importlib.util import find_spec
import os
from pathlib import Path
import sqlite3
from typing import Any

from bag_contents import fill, metadata, numbers, read_with_mcap, read_with_rosbags
import pytest

if find_spec('rclpy') is None:
    pytest.skip('messages are made by rclpy', allow_module_level=True)

from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from tdm_planner.cli import main
from tdm_planner.exceptions import InvalidProblem
from tdm_sim import bag_writer, recorder
from tdm_sim.bag_writer import BagWriter
from tdm_sim.recorder import IncompleteRecording, Progress, record, RecordingError, run
from tdm_sim.wire_types import definition_and_hash, installed_types, message_class


class Endpoint:
    """What a publisher says of itself to the writer."""

    qos_profile = QoSProfile(depth=1)
    topic_type_hash = None


def written(writer: BagWriter, most: int, size: int) -> int:
    """Write messages until one cannot be, at most `most`; how many could."""
    connection = writer.add_topic('/t', 'std_msgs/msg/String', [Endpoint()])
    for k in range(most):
        text = f'{k:06d}' + 'x' * size
        writer.write(connection, 10**9 + k, serialize_message(String(data=text)))
        if writer.failure:
            return k
    return most


@pytest.mark.parametrize('room', [1_500_000, 3_000_000, 3_145_728, None])
def test_a_full_disk_costs_little_of_what_was_written(tmp_path: Path, room: int | None) -> None:
    """Nothing in an MCAP file with room for so many bytes; without, it is a database."""
    bag = tmp_path / 'bag'
    with BagWriter(bag, 'mcap' if room else 'sqlite3') as writer:
        if room:
            fill(writer, room)
        else:  # SQLite says that the disk is full beyond so many pages.
            storage: Any = writer._writer.storage
            connection = storage.conn
            connection.execute('PRAGMA max_page_count=400')
        count = written(writer, 10_000, 1000)
        assert 500 < count < 10_000
        assert ('No space left on device' if room else 'disk is full') in writer.failure
        writer.write(None, 0, b'left out')
        if not room:  # the reserve is given up
            connection.execute('PRAGMA max_page_count=10000')
    assert not (bag / '.reserve').exists()
    found = numbers(read_with_rosbags(bag)['/t'])
    assert found == list(range(len(found)))
    assert metadata(bag)['message_count'] == len(found)
    if room:
        assert len(found) in (count, count + 1)
        assert numbers(read_with_mcap(bag)['/t']) == found


def test_a_disk_too_full_to_begin_is_said_to_be(tmp_path, monkeypatch):
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(bag_writer.os, 'posix_fallocate', full)
    with BagWriter(tmp_path / 'bag') as writer:
        assert 'No space left on device' in writer.failure
    assert read_with_mcap(tmp_path / 'bag') == {}


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_recorder_that_is_killed_leaves_what_was_completed(tmp_path, storage, monkeypatch):
    """What is on disk after `keep`, before the bag is closed, is what a kill leaves."""
    monkeypatch.setattr('tdm_sim.bag_writer.LONGEST_OPEN', 0.0)
    bag, copy = tmp_path / 'bag', tmp_path / 'killed'
    with BagWriter(tmp_path / 'much') as writer:  # however much comes within a second
        assert written(writer, 1500, 1000) == 1500
        assert 1_500_000 - (writer.path / 'much.mcap').stat().st_size < bag_writer.LARGEST_BLOCK
    with BagWriter(bag, storage) as writer:
        assert written(writer, 50, 10) == 50
        writer.keep()
        copy.mkdir()
        for file in bag.iterdir():
            if not file.name.startswith('.'):
                (copy / file.name).write_bytes(file.read_bytes())
    if storage == 'sqlite3':
        database = sqlite3.connect(copy / 'bag.db3')
        assert database.execute('SELECT count(*) FROM messages').fetchone() == (50,)
        database.close()
        return
    from mcap.exceptions import EndOfFile
    from mcap.records import Message
    from mcap.stream_reader import StreamReader

    seen = 0
    with (copy / 'bag.mcap').open('rb') as stream, suppress(EndOfFile):
        for item in StreamReader(stream).records:
            seen += isinstance(item, Message)
    assert seen == 50


def test_folders_and_storages_that_cannot_be_are_refused(tmp_path, capsys):
    (tmp_path / 'precious').write_text('data')
    sentence = f"the folder '{tmp_path}' exists already: choose another or remove it"
    with pytest.raises(RecordingError, match='exists already'):
        record(tmp_path)
    assert main(['record', '-o', str(tmp_path)]) == 2
    assert capsys.readouterr() == ('', f'error: {sentence}\n')
    assert [path.name for path in tmp_path.iterdir()] == ['precious']
    with pytest.raises(RecordingError, match='cannot be made: Not a directory'):
        record(tmp_path / 'precious' / 'bag')
    with pytest.raises(RecordingError, match="'tape' is not allowed: must be one of mcap, sqlite"):
        record(tmp_path / 'bag', storage='tape')


def test_a_message_type_that_is_not_installed_is_told() -> None:
    assert message_class('std_msgs/msg/String') is String
    for name in ('nowhere_msgs/msg/Thing', 'std_msgs/msg/Thing'):
        with pytest.raises(InvalidProblem, match=f"its message type '{name}' is not installed"):
            message_class(name)


@pytest.mark.parametrize('name', ['sensor_msgs/msg/JointState', 'nav_msgs/msg/Odometry'])
def test_definitions_of_installed_packages_have_the_wires_hash(name: str) -> None:
    """Types unknown to `rosbags` are read from their package: known ones must come out alike."""
    standard, type_hash = definition_and_hash(name, None)
    assert installed_types(name).hash_rihs01(name) == type_hash
    for member in ('std_msgs/Header', 'builtin_interfaces/Time'):
        assert f'MSG: {member}' in standard


FIGURES = '61 s, 7 messages on 2 topics, 100/s, 1.2 MB, 2 dropped'
DONE = Progress(61.2, {'/a': 3, '/b': 4}, dropped=2, size=1_250_000, rate=99.6)


@pytest.mark.parametrize('quiet', [False, True])
def test_the_command_tells_how_far_it_is_and_how_it_ended(monkeypatch, capsys, quiet):
    """With the recording itself left out."""
    failures: list[Exception] = []

    def pretend(*_: Any, on_start: Any, on_progress: Any, **__: Any) -> Progress:
        on_start()
        on_progress(DONE)
        if failures:
            raise failures[0]
        return DONE

    monkeypatch.setattr(recorder, 'record', pretend)
    assert run(Path('bag'), [], 'mcap', quiet) == 0
    shown = capsys.readouterr().out
    for words in ('Ctrl-C ends', FIGURES, 'written to bag, 2 dropped', '       4  /b'):
        assert (words in shown) != quiet
    for failure, code in ((IncompleteRecording('full', DONE), 1), (RecordingError('x'), 2)):
        failures[:] = [failure]
        assert run(Path('bag'), [], 'mcap', quiet) == code
        assert capsys.readouterr().err == f'error: {failure}\n'
