# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Writes a rosbag2 by means of the Python package `rosbags`.

The bag stays readable when the disk is full or the recorder is killed: blocks of MCAP and
transactions of SQLite are completed every second, or sooner if they are large, and disk space is
reserved for what must be written at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import os
from pathlib import Path
import sqlite3
import time
from types import MappingProxyType
from typing import Any, ClassVar, get_type_hints, Literal

from rclpy.qos import QoSProfile
from rosbags.interfaces import Qos, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import get_typestore, Stores
from tdm_planner.exceptions import InvalidProblem, TdmError

RESERVE = 8 * 2**20  # bytes: a block of messages, the index of all, the metadata
LONGEST_OPEN = 1.0  # s that messages wait to be completed or committed

StorageError = (OSError, sqlite3.Error)
STORAGES = ('mcap', 'sqlite3')


class _Mcap(McapWriter):
    """An MCAP file that can be cut off after the last complete block, `end` [bytes]."""

    MOST_OPEN = 2**18  # bytes of messages in a block

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.end = self.bio.tell()

    def close_chunk(self) -> None:
        super().close_chunk()
        self.end = self.bio.tell()
        self.bio.flush()

    def complete(self) -> None:
        if self.chunk.msgs:
            self.close_chunk()

    def rescue(self, counts: dict[int, int]) -> None:
        """Repair after a failed write, and set `counts`, messages by topic, to the storage's."""
        self.bio.flush()
        self.bio.seek(self.end)
        self.bio.truncate()
        # The last message is in the open block, although writing it is what failed.
        counts.update(self.channel_stats)


class _Sqlite(Sqlite3Writer):
    """
    A database, with the methods of `_Mcap`.

    SQLite rolls back the transaction when the disk is full: its messages are kept to be written
    again.
    """

    MOST_OPEN = 2**20  # bytes of messages in a transaction, which takes longer than a block

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.complete()

    def add_connection(self, *arguments: Any) -> None:
        super().add_connection(*arguments)
        self.complete()  # or the topic would be forgotten with the transaction

    def write(self, *message: Any) -> None:
        super().write(*message)
        self._open.append(message)

    def complete(self) -> None:
        self.conn.commit()
        self._open: list[tuple[Any, ...]] = []

    def rescue(self, counts: dict[int, int]) -> None:
        if not self.conn.in_transaction:
            for message in self._open:
                super().write(*message)
        self.complete()
        found = self.conn.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id')
        counts.update(dict.fromkeys(counts, 0) | dict(found.fetchall()))


class RecordingError(TdmError):
    """A recording cannot be made; the message says why and what to do."""

    code: ClassVar[str] = 'RECORDING'


def _reason(error: Exception) -> str:
    return getattr(error, 'strerror', None) or str(error)


class BagWriter(Writer):
    """
    A context: the bag's folder is made on entering, and closed as a valid bag on leaving.

    All calls must come from one thread. When a message cannot be written, as on a full disk,
    `failure` says why, further messages are dropped, and earlier ones stay readable.

    Raise RecordingError if `storage` is none of `STORAGES`, or the folder exists; on entering, if
    it cannot be made.
    """

    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: _Mcap, StoragePlugin.SQLITE3: _Sqlite})

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
        self._reserve = path / '.reserve'  # of space: removed when the disk is full
        self._completed = time.monotonic()
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
        except StorageError as error:
            self._fail(error)
        self._open += len(data)
        self.keep()

    def keep(self) -> None:
        """Let what has been written survive a kill, every second; to be called often."""
        now = time.monotonic()
        due = now - self._completed >= LONGEST_OPEN or self._open > self._storage.MOST_OPEN
        if due and not self.failure:
            self._completed, self._open = now, 0
            try:
                self._storage.complete()
            except StorageError as error:
                self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Make a failure of the storage that of the bag: what was written before is rescued."""
        self.failure = f"the bag '{self.path}' cannot be written: {_reason(error)}"
        self._release()
        with suppress(*StorageError):
            self._storage.rescue(self.counts)

    def _release(self) -> None:
        with suppress(OSError):  # the disk may be read-only by now
            self._reserve.unlink()

    def __enter__(self) -> BagWriter:
        try:
            self.open()
        except (*StorageError, WriterError) as error:
            raise RecordingError(
                f"the folder '{self.path}' cannot be made: {_reason(error)}"
            ) from None
        self._storage: Any = self.storage
        try:
            with self._reserve.open('xb') as file:
                os.posix_fallocate(file.fileno(), 0, RESERVE)
        except OSError as error:
            self._fail(error)
        return self

    def __exit__(self, *error: object) -> Literal[False]:
        """Write index and metadata, also after an error: the messages stay readable."""
        self._release()
        for _ in range(2):  # the second time after the storage was put in order
            try:
                self.close()
            except StorageError as full:
                self._fail(full)
            else:
                return False
        self.failure += '; it has no index'
        self.abort()
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
