# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""For tests of what records: messages of a bag by topic, as they were written; a full disk."""

from collections import defaultdict
import errno
import os
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from tdm_sim.bag_writer import BagWriter, RESERVE
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


class FullFile:
    """A file on a disk with room for `room` bytes more; part of what does not fit is written."""

    def __init__(self, file, room: int, reserve: Path) -> None:
        self._file, self._room, self._reserve = file, room, reserve

    def __getattr__(self, name: str):
        return getattr(self._file, name)

    def write(self, data: bytes) -> int:
        room = self._room + (0 if self._reserve.exists() else RESERVE)
        if len(data) > room:
            self._file.write(data[:room])
            self._room -= room
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._room -= len(data)
        return int(self._file.write(data))


def fill(writer: BagWriter, room: int) -> BagWriter:
    """Let the disk that an MCAP file is on be full after so many bytes."""
    storage = writer.storage
    storage.bio = FullFile(storage.bio, room, writer.path / '.reserve')
    return writer
