# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Writes a rosbag2 by means of the Python package `rosbags`.

The bag stays readable when the disk gets full or the recorder is killed: blocks of MCAP and
transactions of SQLite are completed every second, or sooner if they are large, and the bag ends
while there is room for what must be written at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import errno
import math
import os
from pathlib import Path
import shutil
import sqlite3
import time
from typing import Any, ClassVar, get_type_hints, Literal

from rclpy.qos import QoSProfile
from rosbags.interfaces import Qos, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import get_typestore, Stores
from tdm_planner.exceptions import InvalidProblem, TdmError

RESERVE = 8 * 2**20  # bytes that stay free: for a block of messages, the index, the metadata
LONGEST_OPEN = 1.0  # s that messages wait to be completed or committed
MOST_OPEN = 2**19  # bytes of messages that wait

StorageError = (OSError, sqlite3.Error)
STORAGES = ('mcap', 'sqlite3')


class RecordingError(TdmError):
    """A recording cannot be made; the message says why and what to do."""

    code: ClassVar[str] = 'RECORDING'


def _reason(error: Exception) -> str:
    return getattr(error, 'strerror', None) or str(error)


class BagWriter(Writer):
    """
    A context: the bag's folder is made on entering, and closed as a valid bag on leaving.

    All calls must come from one thread. When the disk is full up to `RESERVE`, or a message cannot
    be written, `failure` says so, further messages are dropped, and earlier ones stay readable.

    Raise RecordingError if `storage` is none of `STORAGES`, or the folder exists; on entering, if
    it cannot be made.
    """

    def __init__(self, path: Path, storage: str = 'mcap') -> None:
        if storage not in STORAGES:
            raise RecordingError(
                f"storage = '{storage}' is not allowed: must be one of {', '.join(STORAGES)}"
            )
        if path.exists():
            raise RecordingError(
                f"the folder '{path}' exists already: choose another or remove it"
            )
        plugin = StoragePlugin[storage.upper()]
        super().__init__(path, version=Writer.VERSION_LATEST, storage_plugin=plugin)
        self.failure = ''
        self._completed = -math.inf  # monotonic time
        self._open = 0  # bytes of messages written since then

    @property
    def messages(self) -> dict[str, int]:
        """How many messages are written, by topic."""
        return {one.topic: self.counts[one.id] for one in self.connections}

    @property
    def size(self) -> int:
        """Bytes on disk, metadata aside."""
        with suppress(OSError):  # the file was removed
            return int(self._storage.path.stat().st_size)
        return 0

    def add_topic(self, topic: str, type_name: str, publishers: Sequence[Any]) -> Any:
        """
        Register a topic with what its publishers offer; returns the handle for `write`.

        `publishers` are rclpy's TopicEndpointInfo.
        """
        definition, type_hash = definition_and_hash(type_name, publishers[0].topic_type_hash)
        if self.failure:
            raise RecordingError(self.failure)
        offers = [_offered(item.qos_profile) for item in publishers]
        try:
            return self.add_connection(
                topic, type_name, msgdef=definition, rihs01=type_hash, offered_qos_profiles=offers
            )
        except StorageError as error:
            self._fail(error)
            raise RecordingError(self.failure) from None

    def write(self, connection: Any, timestamp: int, data: bytes | memoryview) -> None:
        """Write one serialized message received at `timestamp` [ns since the epoch]."""
        if self.failure:
            return
        try:
            super().write(connection, timestamp, data)
            self._open += len(data)
            self.keep()
        except StorageError as error:
            self._fail(error)

    def keep(self) -> None:
        """Let what has been written survive a kill, every second; to be called often."""
        now = time.monotonic()
        open_for = now - self._completed
        if self.failure or (open_for < LONGEST_OPEN and self._open < MOST_OPEN):
            return
        self._completed, self._open = now, 0
        try:
            self._complete()
            free = shutil.disk_usage(self.path).free
        except StorageError as error:
            self._fail(error)
            return
        if free < RESERVE:
            self._say(os.strerror(errno.ENOSPC))

    def _complete(self) -> None:
        if not isinstance(self._storage, McapWriter):
            self._storage.conn.commit()
            return
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
        self._storage.bio.flush()

    def _fail(self, error: Exception) -> None:
        """Leave the bag as a kill would: readable up to what was completed."""
        self._say(f'{_reason(error)}; it has no index')
        with suppress(*StorageError):
            self.abort()

    def _say(self, reason: str) -> None:
        self.failure = f"the bag '{self.path}' cannot be written: {reason}"

    def __enter__(self) -> BagWriter:
        try:
            self.open()
        except (*StorageError, WriterError) as error:
            raise RecordingError(
                f"the folder '{self.path}' cannot be made: {_reason(error)}"
            ) from None
        self._storage: Any = self.storage
        return self

    def __exit__(self, *error: object) -> Literal[False]:
        """Write index and metadata, also after an error: the messages stay readable."""
        if self.storage is not None:
            try:
                self.close()
            except StorageError as full:
                self._fail(full)
        return False


def _offered(profile: QoSProfile) -> Qos:
    """Return a publisher's offer as `rosbags` writes it; names and numbers are those of rclpy."""
    offer: dict[str, Any] = {}
    for name, kind in get_type_hints(Qos).items():
        value = getattr(profile, name)
        offer[name] = (
            QosTime(*divmod(value.nanoseconds, 10**9)) if kind is QosTime else kind(int(value))
        )
    return Qos(**offer)


def definition_and_hash(type_name: str, wire_hash: Any) -> tuple[str, str]:
    """
    Return the definition of a message type with its members', and its hash, the wire's if known.

    Raise InvalidProblem if it is no type of ROS 2 Jazzy itself.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    if type_name not in store.fielddefs:
        raise InvalidProblem(f"its message type '{type_name}' does not come with ROS 2 Jazzy")
    definition, _ = store.generate_msgdef(type_name, ros_version=2)
    on_wire = getattr(wire_hash, 'version', 0) > 0
    return definition, str(wire_hash) if on_wire else store.hash_rihs01(type_name)
