# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 being written, by way of the Python package `rosbags`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar

from tdm_planner.exceptions import TdmError
from tdm_sim.wire_types import definition_and_hash, offered_profile

STORAGES = ('mcap', 'sqlite3')


class RecordingError(TdmError):
    """A recording cannot be made; the message says why and what to do."""

    code: ClassVar[str] = 'RECORDING'


class BagWriter:
    """A context: the bag's folder is made on entering, and closed as a valid bag on leaving.

    `storage` is one of `STORAGES`. All calls must come from one thread.

    Raises
    ------
    RecordingError
        On entering, if the folder exists or cannot be made; at once, if `storage` is unknown or
        the package `rosbags` is not installed.
    """

    def __init__(self, path: Path, storage: str = 'mcap') -> None:
        if storage not in STORAGES:
            raise RecordingError(
                f"storage = '{storage}' is not allowed: must be one of {', '.join(STORAGES)}"
            )
        try:
            from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
        except ImportError:
            raise RecordingError(
                "recording needs the Python package 'rosbags', which is not installed: "
                "'pip install rosbags', or use 'ros2 bag record' where ROS 2 is installed"
            ) from None
        self.path = path
        self._topics: dict[int, str] = {}
        self._taken = f"the folder '{path}' exists already: choose another or remove it"
        try:
            self._writer = Writer(
                path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin[storage.upper()]
            )
        except WriterError:
            raise RecordingError(self._taken) from None

    @property
    def counts(self) -> dict[str, int]:
        """Messages written, by topic."""
        return {topic: self._writer.counts[key] for key, topic in self._topics.items()}

    def add_topic(self, topic: str, type_name: str, publishers: Sequence[Any]) -> Any:
        """Register a topic with what its publishers offer; returns the handle for `write`.

        `publishers` are rclpy's TopicEndpointInfo.
        """
        definition, type_hash = definition_and_hash(type_name, publishers[0].topic_type_hash)
        connection = self._writer.add_connection(
            topic,
            type_name,
            msgdef=definition,
            rihs01=type_hash,
            offered_qos_profiles=[offered_profile(item.qos_profile) for item in publishers],
        )
        self._topics[connection.id] = topic
        return connection

    def write(self, connection: Any, stamp: int, data: bytes) -> None:
        """Write one serialized message received at `stamp` [ns since the epoch]."""
        self._writer.write(connection, stamp, data)

    def __enter__(self) -> BagWriter:
        """Make the folder and open the files in it."""
        try:
            self._writer.open()
        except FileExistsError:
            raise RecordingError(self._taken) from None
        except OSError as error:
            raise RecordingError(
                f"the folder '{self.path}' cannot be made: {error.strerror}"
            ) from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write index and metadata, whatever happened: what was received stays readable."""
        self._writer.close()
