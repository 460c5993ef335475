# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
import errno
import os
from pathlib import Path
import pty
import re
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_harness import NodeProcess, Ros
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tdm_planner.cli import main
from tdm_sim import full_disk
from tdm_sim.bag_writer import BagWriter
from tdm_sim.recorder import IncompleteRecording, Progress, record, RecordingError
import yaml

LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


def start(ros: Ros, output: Path, *arguments: str) -> NodeProcess:
    """Start the recorder as the process that `tdm record` is."""
    process = NodeProcess(
        'tdm_planner.cli', ['record', '-o', str(output), *arguments], ros.environment, ros.folder
    )
    assert ros.spin_until(output.is_dir, 20.0), process.output
    return process


def read_with_mcap(bag: Path) -> dict[str, list[Any]]:
    """Read a bag by a reader that has nothing in common with the writer."""
    reader = pytest.importorskip('mcap_ros2.reader')
    messages = defaultdict(list)
    for item in reader.read_ros2_messages(bag / f'{bag.name}.mcap'):
        messages[item.channel.topic].append(item.ros_msg)
    return messages


def read_with_rosbags(bag: Path) -> dict[str, list[Any]]:
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    messages = defaultdict(list)
    with rosbag2.Reader(bag) as reader:
        for connection, _, data in reader.messages():
            messages[connection.topic].append(store.deserialize_cdr(data, connection.msgtype))
    return messages


@pytest.mark.parametrize(
    ('storage', 'read', 'number'),
    [('mcap', read_with_mcap, signal.SIGTERM), ('sqlite3', read_with_rosbags, signal.SIGINT)],
)
def test_every_message_is_in_the_bag(
    ros: Ros,
    tmp_path: Path,
    storage: str,
    read: Callable[[Path], dict[str, list[Any]]],
    number: signal.Signals,
) -> None:
    bag = tmp_path / 'bag'
    names = [f'/{storage}/{name}' for name in ('latched', 'states', 'late', 'hasty')]
    latched = ros.node.create_publisher(String, names[0], LATCHED)
    latched.publish(String(data='published before the recorder came'))
    recorder = start(ros, bag, '--storage', storage)
    states = ros.publisher(names[1], JointState)
    for k in range(300):
        states.publish(JointState(name=['disk'], position=[0.5 * k], effort=[-1.0 * k]))
        time.sleep(0.002)
    late = ros.publisher(names[2], String)
    late.publish(String(data='a late topic'))
    hasty = ros.publisher(names[3], String, BEST_EFFORT)
    hasty.publish(String(data='best effort'))
    ros.spin_for(0.5)
    assert recorder.end(number) == 0, recorder.output
    assert 'Traceback' not in recorder.output
    messages = read(bag)
    assert [m.position[0] for m in messages[names[1]]] == [0.5 * k for k in range(300)]
    assert [m.effort[0] for m in messages[names[1]]] == [-1.0 * k for k in range(300)]
    assert [m.data for m in messages[names[0]]] == ['published before the recorder came']
    assert [m.data for m in messages[names[2]]] == ['a late topic']
    assert [m.data for m in messages[names[3]]] == ['best effort']
    check_metadata(ros, bag, storage, names)
    for publisher in (latched, states, late, hasty):
        ros.node.destroy_publisher(publisher)


def check_metadata(ros: Ros, bag: Path, storage: str, names: list[str]) -> None:
    """Compare what rosbag2's own file says with the wire."""
    document = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert document['storage_identifier'] == storage
    topics = {
        entry['topic_metadata']['name']: (entry['topic_metadata'], entry['message_count'])
        for entry in document['topics_with_message_count']
    }
    assert document['message_count'] == sum(count for _, count in topics.values())
    for name, count in zip(names, (1, 300, 1, 1), strict=True):
        metadata, written = topics[name]
        assert written == count
        (endpoint,) = ros.node.get_publishers_info_by_topic(name)
        assert metadata['type'] == endpoint.topic_type
        assert metadata['type_description_hash'] == str(endpoint.topic_type_hash)
        (offered,) = metadata['offered_qos_profiles']
        assert offered['reliability'] == endpoint.qos_profile.reliability.name.lower()
        assert offered['durability'] == endpoint.qos_profile.durability.name.lower()


def test_only_the_topics_asked_for(ros: Ros, tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    recorder = start(ros, bag, 'chosen/one')
    chosen = ros.publisher('/chosen/one', String)
    other = ros.node.create_publisher(String, '/chosen/two', 10)
    for publisher in (chosen, other):
        publisher.publish(String(data='x'))
    ros.spin_for(0.3)
    assert recorder.end() == 0
    assert list(read_with_mcap(bag)) == ['/chosen/one']
    assert re.search(r'^1 messages in .* written to .*, 0 dropped$', recorder.output, re.MULTILINE)


def test_a_namespace_and_nothing_of_others(ros: Ros, tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    topics = ('/mine/one/state', '/mine/plan', '/other/plan', '/minecraft/plan', '/tf')
    publishers = [ros.node.create_publisher(String, topic, LATCHED) for topic in topics]
    for publisher in publishers:
        publisher.publish(String(data='x'))
    recorder = start(ros, bag, '--namespace', 'mine')
    assert ros.spin_until(
        lambda: all(publishers[k].get_subscription_count() > 0 for k in (0, 1, 4))
    )
    ros.spin_for(0.3)
    assert recorder.end() == 0
    assert set(read_with_mcap(bag)) - {'/rosout', '/clock', '/diagnostics', '/tf_static'} == {
        '/mine/one/state', '/mine/plan', '/tf',
    }  # fmt: skip
    for publisher in publishers:
        ros.node.destroy_publisher(publisher)


def test_a_message_type_that_is_not_installed_is_skipped_with_a_reason(ros: Ros) -> None:
    from tdm_planner.exceptions import InvalidProblem
    from tdm_sim.wire_types import message_class

    assert message_class('std_msgs/msg/String') is String
    for name in ('nowhere_msgs/msg/Thing', 'std_msgs/msg/Thing'):
        with pytest.raises(InvalidProblem, match=f"its message type '{name}' is not installed"):
            message_class(name)


@pytest.mark.parametrize('name', ['sensor_msgs/msg/JointState', 'nav_msgs/msg/Odometry'])
def test_definitions_of_installed_packages_have_the_wires_hash(ros: Ros, name: str) -> None:
    """Types unknown to `rosbags` are read from their package: known ones must come out alike."""
    from tdm_sim.wire_types import definition_and_hash, installed_types

    standard, type_hash = definition_and_hash(name, None)
    assert installed_types(name).hash_rihs01(name) == type_hash
    for member in ('std_msgs/Header', 'builtin_interfaces/Time'):
        assert f'MSG: {member}' in standard


def test_progress_stop_and_thread(ros: Ros, tmp_path: Path) -> None:
    """The library function, away from the main thread."""
    stop, seen = threading.Event(), list[Progress]()
    results: list[Progress] = []
    thread = threading.Thread(
        target=lambda: results.append(
            record(tmp_path / 'bag', ['/thread'], stop=stop, on_progress=seen.append)
        )
    )
    thread.start()
    publisher = ros.publisher('/thread', String)
    publisher.publish(String(data='x'))
    assert ros.spin_until(lambda: bool(seen) and seen[-1].messages == 1)
    stop.set()
    thread.join(10.0)
    assert not thread.is_alive()
    assert dict(results[0].counts) == {'/thread': 1}
    assert results[0].elapsed >= seen[-1].elapsed > 0.0
    assert len(read_with_mcap(tmp_path / 'bag')['/thread']) == 1


def test_ends_by_itself_after_its_duration(ros: Ros, tmp_path: Path) -> None:
    done = record(tmp_path / 'bag', ['/silence'], 'sqlite3', duration=0.2)
    assert done.elapsed >= 0.2
    assert done.messages == 0
    assert read_with_rosbags(tmp_path / 'bag') == {}


def test_an_existing_folder_is_refused_and_left_alone(
    ros: Ros, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'precious').write_text('data')
    with pytest.raises(RecordingError, match='exists already: choose another or remove it'):
        record(tmp_path)
    assert main(['record', '-o', str(tmp_path)]) == 2
    shown = capsys.readouterr()
    assert shown.out == ''
    assert shown.err == (
        f"error: the folder '{tmp_path}' exists already: choose another or remove it\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ['precious']


def test_a_folder_that_cannot_be_made_and_an_unknown_storage(ros: Ros, tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(RecordingError, match='cannot be made: Not a directory'):
        record(tmp_path / 'file' / 'bag')
    with pytest.raises(RecordingError, match="'tape' is not allowed: must be one of mcap, sqlite"):
        record(tmp_path / 'bag', storage='tape')


class FullFile:
    """A file on a disk with room for `room` bytes more; part of what does not fit is written."""

    def __init__(self, file: Any, room: int, reserve: Path) -> None:
        self._file, self._room, self._reserve = file, room, reserve

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: bytes) -> int:
        room = self._room + (0 if self._reserve.exists() else full_disk.RESERVE)
        if len(data) > room:
            self._file.write(data[:room])
            self._room -= room
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._room -= len(data)
        return int(self._file.write(data))


class Endpoint:
    """What a publisher says of itself to the writer."""

    qos_profile = LATCHED
    topic_type_hash = None


def written(writer: BagWriter, most: int, size: int) -> int:
    """Write messages until one cannot be, at most `most`; how many could."""
    from rclpy.serialization import serialize_message

    connection = writer.add_topic('/t', 'std_msgs/msg/String', [Endpoint()])
    for k in range(most):
        text = f'{k:06d}' + 'x' * size
        writer.write(connection, 10**9 + k, serialize_message(String(data=text)))
        if writer.failure:
            return k
    return most


def numbers(messages: list[Any]) -> list[int]:
    return [int(message.data[:6]) for message in messages]


@pytest.mark.parametrize('room', [1_500_000, 3_000_000, 3_145_728])
def test_a_full_disk_costs_nothing_that_was_written_to_an_mcap_file(
    tmp_path: Path, room: int
) -> None:
    bag = tmp_path / 'bag'
    with BagWriter(bag) as writer:
        storage = writer._writer.storage
        storage.bio = FullFile(storage.bio, room, bag / '.reserve')
        count = written(writer, 10_000, 1000)
        assert count < 10_000
        assert 'No space left on device' in writer.failure
        writer.write(None, 0, b'left out')
    assert not (bag / '.reserve').exists()
    found = numbers(read_with_mcap(bag)['/t'])
    assert found == list(range(count)) or found == list(range(count + 1))
    assert numbers(read_with_rosbags(bag)['/t']) == found
    metadata = yaml.safe_load((bag / 'metadata.yaml').read_text())
    assert metadata['rosbag2_bagfile_information']['message_count'] == len(found)


def limit_pages(writer: BagWriter, pages: int) -> None:
    """Let SQLite say that the disk is full beyond so many pages."""
    writer._writer.storage.conn.execute(f'PRAGMA max_page_count={pages}')


def test_a_full_disk_leaves_a_database_that_can_be_read(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    with BagWriter(bag, 'sqlite3') as writer:
        limit_pages(writer, 400)
        count = written(writer, 10_000, 1000)
        assert 500 < count < 10_000
        assert 'disk is full' in writer.failure
        limit_pages(writer, 10_000)  # the reserve is given up
    found = numbers(read_with_rosbags(bag)['/t'])
    assert found == list(range(len(found)))
    metadata = yaml.safe_load((bag / 'metadata.yaml').read_text())
    assert metadata['rosbag2_bagfile_information']['message_count'] == len(found)


def test_a_disk_too_full_to_begin_is_said_to_be(
    ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(full_disk.os, 'posix_fallocate', full)
    with pytest.raises(IncompleteRecording, match='No space left on device; the recording ends'):
        record(tmp_path / 'bag', duration=5.0)
    assert read_with_mcap(tmp_path / 'bag') == {}


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Yield a file system of 12 MB."""
    folder = tmp_path / 'small'
    folder.mkdir()
    command = ['mount', '-t', 'tmpfs', '-o', 'size=12m', 'tmpfs', str(folder)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip('mounting is not permitted here')
    yield folder
    # Python 3.10 may hold a database of rosbags' until its cursors are collected.
    subprocess.run(['umount', '--lazy', str(folder)], check=True)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_recording_that_fills_the_disk_ends_with_a_reason_and_a_whole_bag(
    ros: Ros, small_disk: Path, storage: str
) -> None:
    bag = small_disk / 'bag'
    publisher = ros.node.create_publisher(String, f'/full/{storage}', 100)
    recorder = start(ros, bag, publisher.topic, '--storage', storage)
    assert ros.spin_until(lambda: publisher.get_subscription_count() > 0)
    sent = 0
    while recorder.running and sent < 2000:
        publisher.publish(String(data=f'{sent:06d}' + 'x' * 10_000))
        sent += 1
        time.sleep(0.002)
    assert ros.spin_until(lambda: not recorder.running), recorder.output
    assert recorder.end() == 1
    assert 'Traceback' not in recorder.output
    assert re.search(r'error: .*(No space left|disk is full).*; the recording ends there, with',
                     recorder.output)  # fmt: skip
    found = numbers(read_with_rosbags(bag)[publisher.topic])
    assert found == list(range(len(found)))
    assert len(found) > 200
    said = re.search(r'with (\d+) messages', recorder.output)
    assert said is not None
    assert int(said.group(1)) == len(found)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_recorder_that_is_killed_leaves_what_was_completed(
    tmp_path: Path, storage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is on disk after `keep`, before the bag is closed, is what a kill leaves."""
    monkeypatch.setattr('tdm_sim.bag_writer.LONGEST_OPEN', 0.0)
    bag, copy = tmp_path / 'bag', tmp_path / 'killed'
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
    else:
        from mcap.exceptions import EndOfFile
        from mcap.records import Message
        from mcap.stream_reader import StreamReader

        seen = 0
        with (copy / 'bag.mcap').open('rb') as stream, suppress(EndOfFile):
            for item in StreamReader(stream).records:
                seen += isinstance(item, Message)
        assert seen == 50


def test_blocks_are_small_enough_to_lose(tmp_path: Path) -> None:
    """What a kill at any time leaves on disk, however much comes within a second."""
    bag = tmp_path / 'bag'
    with BagWriter(bag) as writer:
        assert written(writer, 1500, 1000) == 1500
        assert 1_500_000 - (bag / 'bag.mcap').stat().st_size < full_disk.LARGEST_BLOCK
    assert len(read_with_mcap(bag)['/t']) == 1500


def test_figures_of_the_progress_line() -> None:
    shown = str(Progress(61.2, {'/a': 3, '/b': 4}, dropped=2, size=1_250_000, rate=99.6))
    assert shown == '61 s, 7 messages on 2 topics, 100/s, 1.2 MB, 2 dropped'


def test_figures_while_recording(ros: Ros, tmp_path: Path) -> None:
    seen: list[Progress] = []
    publisher = ros.node.create_publisher(String, '/figures', 100)
    stop = threading.Event()
    done: list[Progress] = []
    thread = threading.Thread(
        target=lambda: done.append(
            record(tmp_path / 'bag', ['/figures'], stop=stop, on_progress=seen.append)
        )
    )
    thread.start()
    assert ros.spin_until(lambda: publisher.get_subscription_count() > 0)
    begun = time.monotonic()
    while len(seen) < 4 and time.monotonic() - begun < 20.0:
        publisher.publish(String(data='x' * 1000))
        time.sleep(0.005)
    stop.set()
    thread.join(10.0)
    rates = [progress.rate for progress in seen[1:]]
    assert max(rates) > 20.0
    assert done[0].dropped == 0
    file = tmp_path / 'bag' / 'bag.mcap'
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    assert done[0].size == file.stat().st_size + metadata.stat().st_size
    assert done[0].messages * 1000 < done[0].size
    assert done[0].rate == pytest.approx(done[0].messages / done[0].elapsed)


def test_messages_that_were_lost_on_the_way_are_counted(ros: Ros, tmp_path: Path) -> None:
    """A flood that a recorder, stopped for a while, cannot take up."""
    publisher = ros.node.create_publisher(String, '/lost', BEST_EFFORT)
    recorder = start(ros, tmp_path / 'bag', '/lost')
    assert ros.spin_until(lambda: publisher.get_subscription_count() > 0)
    os.kill(recorder.process.pid, signal.SIGSTOP)
    for _ in range(4000):
        publisher.publish(String(data='x' * 60_000))
    os.kill(recorder.process.pid, signal.SIGCONT)
    for _ in range(20):
        publisher.publish(String(data='x'))
        ros.spin_for(0.05)
    assert recorder.end() == 0
    received = len(read_with_mcap(tmp_path / 'bag')['/lost'])
    lost = re.search(r'written to .*, (\d+) dropped', recorder.output)
    assert lost is not None, recorder.output
    assert 0 < int(lost.group(1)) <= 4020 - received


def test_a_live_line_on_a_terminal(ros: Ros, tmp_path: Path) -> None:
    leader, follower = pty.openpty()
    command = [sys.executable, '-m', 'tdm_planner.cli', 'record', '-o', str(tmp_path / 'bag')]
    process = subprocess.Popen(
        command, env=ros.environment, stdout=follower, stderr=follower, close_fds=True
    )
    os.close(follower)
    shown = b''
    begun = time.monotonic()
    while b'dropped' not in shown and time.monotonic() - begun < 20.0:
        shown += os.read(leader, 4096)
    process.send_signal(signal.SIGINT)
    while process.poll() is None:
        try:
            shown += os.read(leader, 4096)
        except OSError:  # the terminal's other end is closed
            break
    assert process.wait(10.0) == 0
    os.close(leader)
    assert re.search(rb'\d+ s, \d+ messages on \d+ topics, \d+/s, [\d.]+ MB, 0 dropped', shown)


def test_quiet_prints_nothing(ros: Ros, tmp_path: Path) -> None:
    recorder = start(ros, tmp_path / 'bag', '-q')
    assert recorder.end(signal.SIGTERM) == 0
    assert recorder.output == ''
