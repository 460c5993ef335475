# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Writes a rosbag2 by means of the Python package `rosbags`.

The bag stays readable when the disk is full or the recorder is killed. `rosbags` writes MCAP in
blocks of a megabyte and SQLite in a single transaction: here blocks are completed and transactions
committed every second, or sooner if they are large, and disk space is reserved for what must be
written at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import os
from pathlib import Path
import sqlite3
import time
from types import MappingProxyType
from typing import Any, ClassVar

from rclpy.qos import QoSProfile
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import get_typestore, Stores
from tdm_planner.exceptions import InvalidProblem, TdmError

RESERVE = 8 * 2**20  # bytes: a block of messages, the index of all, the metadata
LONGEST_OPEN = 1.0  # s that messages wait to be completed or committed
LARGEST_BLOCK = 2**18  # bytes of messages in a block of MCAP
MOST_OPEN = 2**20  # bytes of messages that wait in SQLite, where committing them takes longer

StorageError = (OSError, sqlite3.Error)
STORAGES = ('mcap', 'sqlite3')


class _Mcap(McapWriter):
    """An MCAP file that can be cut off after the last complete block, `end` [bytes]."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.end = self.bio.tell()

    def close_chunk(self) -> None:
        super().close_chunk()
        self.end = self.bio.tell()
        self.bio.flush()

    def write(self, connection: Any, timestamp: int, data: bytes | memoryview) -> None:
        super().write(connection, timestamp, data)
        if self.chunk.bio.tell() > LARGEST_BLOCK:
            self.close_chunk()

    def complete(self) -> None:
        """Complete what has been written last, so that it survives a kill."""
        if self.chunk.msgs:
            self.close_chunk()

    def rescue(self, counts: dict[int, int]) -> None:
        """
        Repair the storage after a failed write, with the reserve freed.

        `counts`, messages by topic, are set to those of the storage.
        """
        self.bio.flush()
        self.bio.seek(self.end)
        self.bio.truncate()
        # The last message is in the open block, although writing it is what failed.
        counts.update(self.channel_stats)


class _Sqlite(Sqlite3Writer):
    """
    A database: SQLite rolls back the open transaction when the disk is full.

    The messages in it are kept here until they are committed, to be written again. Methods are
    those of `_Mcap`.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.complete()

    def add_connection(self, *arguments: Any) -> None:
        super().add_connection(*arguments)
        self.complete()  # or the topic would be forgotten with the transaction

    def write(self, connection: Any, timestamp: int, data: bytes | memoryview) -> None:
        super().write(connection, timestamp, data)
        self._open.append((connection, timestamp, data))
        self._size += len(data)
        if self._size > MOST_OPEN:
            self.complete()

    def complete(self) -> None:
        self.conn.commit()
        self._open: list[tuple[Any, int, bytes | memoryview]] = []
        self._size = 0

    def rescue(self, counts: dict[int, int]) -> None:
        if not self.conn.in_transaction:
            for message in self._open:
                super().write(*message)
        self.complete()
        found = self.conn.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id')
        counts.update(dict.fromkeys(counts, 0) | dict(found.fetchall()))


class _Writer(Writer):
    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: _Mcap, StoragePlugin.SQLITE3: _Sqlite})


class RecordingError(TdmError):
    """A recording cannot be made; the message says why and what to do."""

    code: ClassVar[str] = 'RECORDING'


def _reason(error: Exception) -> str:
    return getattr(error, 'strerror', None) or str(error)


class BagWriter:
    """
    A context: the bag's folder is made on entering, and closed as a valid bag on leaving.

    `storage` is one of `STORAGES`. All calls must come from one thread. When a message cannot be
    written, as on a full disk, `failure` says why. Further messages are then dropped, and earlier
    ones stay readable.

    Raise RecordingError on entering, if the folder exists or cannot be made; at once, if `storage`
    is unknown.
    """

    def __init__(self, path: Path, storage: str = 'mcap') -> None:
        if storage not in STORAGES:
            raise RecordingError(
                f"storage = '{storage}' is not allowed: must be one of {', '.join(STORAGES)}"
            )
        self.path = path
        self.failure = ''
        self._reserve = path / '.reserve'  # of space: removed when the disk is full
        self._completed = time.monotonic()
        self._plugin = StoragePlugin[storage.upper()]

    @property
    def counts(self) -> dict[str, int]:
        """Messages written, by topic."""
        return {one.topic: self._writer.counts[one.id] for one in self._writer.connections}

    @property
    def size(self) -> int:
        """Bytes on disk, metadata aside."""
        sizes = 0
        for file in self.path.glob('[!.]*'):
            with suppress(OSError):  # SQLite's journal comes and goes
                sizes += file.stat().st_size
        return sizes

    def add_topic(self, topic: str, type_name: str, publishers: Sequence[Any]) -> Any:
        """
        Register a topic with what its publishers offer; returns the handle for `write`.

        `publishers` are rclpy's TopicEndpointInfo.
        """
        definition, type_hash = definition_and_hash(type_name, publishers[0].topic_type_hash)
        try:
            return self._writer.add_connection(
                topic,
                type_name,
                msgdef=definition,
                rihs01=type_hash,
                offered_qos_profiles=[_offered(item.qos_profile) for item in publishers],
            )
        except StorageError as error:
            self._fail(error)
            raise RecordingError(self.failure) from None

    def write(self, connection: Any, stamp: int, data: bytes) -> None:
        """Write one serialized message received at `stamp` [ns since the epoch]."""
        if self.failure:
            return
        try:
            self._writer.write(connection, stamp, data)
        except StorageError as error:
            self._fail(error)

    def keep(self) -> None:
        """Let what has been written survive a kill, every second; to be called often."""
        now = time.monotonic()
        if self.failure or now - self._completed < LONGEST_OPEN:
            return
        self._completed = now
        try:
            self._storage.complete()
        except StorageError as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.failure = f"the bag '{self.path}' cannot be written: {_reason(error)}"
        self._release()
        with suppress(*StorageError):
            self._storage.rescue(self._writer.counts)

    def __enter__(self) -> BagWriter:
        """Make the folder and open the files in it."""
        try:
            self._writer = _Writer(
                self.path, version=Writer.VERSION_LATEST, storage_plugin=self._plugin
            )
            self._writer.open()
        except WriterError:
            raise RecordingError(
                f"the folder '{self.path}' exists already: choose another or remove it"
            ) from None
        except StorageError as error:
            raise RecordingError(
                f"the folder '{self.path}' cannot be made: {_reason(error)}"
            ) from None
        self._storage: Any = self._writer.storage
        try:
            with self._reserve.open('xb') as file:
                os.posix_fallocate(file.fileno(), 0, RESERVE)
        except OSError as error:
            self._fail(error)
        return self

    def _release(self) -> None:
        with suppress(OSError):  # the disk may be read-only by now
            self._reserve.unlink()

    def __exit__(self, *error: object) -> None:
        """Write index and metadata, also after an error: the messages stay readable."""
        self._release()
        try:
            try:
                self._writer.close()
            except StorageError as full:  # put the storage in order first
                self._fail(full)
                self._writer.close()
        except StorageError as failure:
            self.failure = (
                f"the bag '{self.path}' could not be completed ({_reason(failure)}): it has no "
                'index'
            )
            self._writer.abort()


def _offered(profile: QoSProfile) -> Qos:
    """Return a publisher's offer as `rosbags` writes it."""

    def time(duration: Any) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, 10**9))

    return Qos(
        history=QosHistory(int(profile.history)),
        depth=profile.depth,
        reliability=QosReliability(int(profile.reliability)),
        durability=QosDurability(int(profile.durability)),
        deadline=time(profile.deadline),
        lifespan=time(profile.lifespan),
        liveliness=QosLiveliness(int(profile.liveliness)),
        liveliness_lease_duration=time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def definition_and_hash(type_name: str, wire_hash: Any) -> tuple[str, str]:
    """
    Return the definition of a message type, those of its members appended, and its type hash.

    The hash is that on the wire, where there is one.

    Raise InvalidProblem if it is no type of ROS 2 Jazzy itself.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    if type_name not in store.fielddefs:
        raise InvalidProblem(f"its message type '{type_name}' does not come with ROS 2 Jazzy")
    on_wire = str(wire_hash) if getattr(wire_hash, 'version', 0) > 0 else ''
    definition, _ = store.generate_msgdef(type_name, ros_version=2)
    return definition, on_wire or store.hash_rihs01(type_name)
