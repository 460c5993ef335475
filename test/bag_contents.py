# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""For tests of what records: messages of a bag by topic, as written; a disk that gets full."""

from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from tdm_sim import bag_writer
import yaml


def read_with_mcap(bag: Path) -> dict[str, list]:
    """Read a bag by a reader that has nothing in common with the writer."""
    reader = pytest.importorskip('mcap_ros2.reader')
    messages = defaultdict(list)
    for item in reader.read_ros2_messages(bag / f'{bag.name}.mcap'):
        messages[item.channel.topic].append(item.ros_msg)
    return messages


def read_with_rosbags(bag: Path) -> dict[str, list]:
    store, messages = get_typestore(Stores.ROS2_JAZZY), defaultdict(list)
    with Reader(bag) as reader:
        for connection, _, data in reader.messages():
            messages[connection.topic].append(store.deserialize_cdr(data, connection.msgtype))
    return messages


def metadata(bag: Path):
    return yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


def numbers(messages: list) -> list[int]:
    return [int(message.data[:6]) for message in messages]


def fill(monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    """Let a bag be on a disk with room for so many bytes beside what is reserved."""

    def usage(path: Path) -> SimpleNamespace:
        used = sum(file.stat().st_size for file in path.iterdir())
        return SimpleNamespace(free=bag_writer.RESERVE + room - used)

    monkeypatch.setattr(bag_writer.shutil, 'disk_usage', usage)
