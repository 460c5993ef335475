# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
import signal
import threading
import time
from typing import Any

import pytest
from ros_harness import NodeProcess, Ros
import yaml

pytest.importorskip('rclpy')
pytest.importorskip('rosbags')

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from tdm_planner.cli import main
from tdm_sim.recorder import Progress, record, RecordingError

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
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    messages = defaultdict(list)
    with Reader(bag) as reader:
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
    assert '1 messages' in recorder.output


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
    assert capsys.readouterr().err == (
        f"error: the folder '{tmp_path}' exists already: choose another or remove it\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ['precious']


def test_a_folder_that_cannot_be_made_and_an_unknown_storage(ros: Ros, tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(RecordingError, match='cannot be made: Not a directory'):
        record(tmp_path / 'file' / 'bag')
    with pytest.raises(RecordingError, match="'tape' is not allowed: must be one of mcap, sqlite"):
        record(tmp_path / 'bag', storage='tape')


def test_without_rosbags_the_way_out_is_named(
    ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__('sys').modules, 'rosbags.rosbag2', None)
    with pytest.raises(RecordingError, match="'pip install rosbags', or use 'ros2 bag record'"):
        record(tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()
