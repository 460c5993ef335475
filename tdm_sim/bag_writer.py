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
from types import TracebackType
from typing import Any, ClassVar

from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from tdm_planner.exceptions import TdmError
from tdm_sim.wire_types import definition_and_hash, offered_profile

RESERVE = 8 * 2**20  # bytes: a block of messages, the index of all, the metadata
LONGEST_OPEN = 1.0  # s that messages wait to be completed or committed
LARGEST_BLOCK = 2**18  # bytes of messages in a block of MCAP
MOST_OPEN = 2**20  # bytes of messages that wait in SQLite, where committing them takes longer

StorageError = (OSError, sqlite3.Error)
STORAGES = ('mcap', 'sqlite3')


class _McapKeeper:
    """
    Keeps blocks of an MCAP file readable.

    One that was written in part is cut off, and written again.
    """

    def __init__(self, storage: Any) -> None:
        self._storage = storage
        self._blocks = 0
        self._end = int(storage.bio.tell())

    def written(self, topic: int, stamp: int, data: bytes) -> None:
        """Note that a message has been written."""
        if self._storage.chunk.bio.tell() > LARGEST_BLOCK:
            self._storage.close_chunk()
        self._note_blocks()

    def _note_blocks(self) -> None:
        if len(self._storage.chunks) != self._blocks:
            self._blocks = len(self._storage.chunks)
            self._end = int(self._storage.bio.tell())
            self._storage.bio.flush()

    def complete(self) -> None:
        """Complete what has been written last, so that it survives a kill."""
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
            self._note_blocks()

    def rescue(self, counts: dict[int, int]) -> None:
        """
        Repair the storage after a failed write, with the reserve freed.

        `counts`, messages by topic, are set to those of the storage.
        """
        file = self._storage.bio
        file.flush()
        file.seek(self._end)
        file.truncate()
        # The last message is in the open block, although writing it is what failed.
        counts.update(self._storage.channel_stats)


class _SqliteKeeper:
    """
    Keeps a database's transactions: SQLite rolls back the open one when the disk is full.

    The messages in it are kept here until they are committed, to be written again. Methods are
    those of `_McapKeeper`.
    """

    def __init__(self, storage: Any) -> None:
        self._connection: sqlite3.Connection = storage.conn
        self._connection.commit()
        self._open: list[tuple[int, int, bytes]] = []
        self._size = 0

    def written(self, topic: int, stamp: int, data: bytes) -> None:
        self._open.append((topic, stamp, data))
        self._size += len(data)
        if self._size > MOST_OPEN:
            self.complete()

    def complete(self) -> None:
        self._connection.commit()
        self._open.clear()
        self._size = 0

    def rescue(self, counts: dict[int, int]) -> None:
        if not self._connection.in_transaction:
            self._connection.executemany(
                'INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)', self._open
            )
        self.complete()
        found = self._connection.execute(
            'SELECT topic_id, count(*) FROM messages GROUP BY topic_id'
        )
        kept = dict(found.fetchall())
        counts.update({key: kept.get(key, 0) for key in counts})


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

    Raises
    ------
    RecordingError
        On entering, if the folder exists or cannot be made; at once, if `storage` is unknown.

    """

    def __init__(self, path: Path, storage: str = 'mcap') -> None:
        if storage not in STORAGES:
            raise RecordingError(
                f"storage = '{storage}' is not allowed: must be one of {', '.join(STORAGES)}"
            )
        self.path = path
        self.failure = ''
        self._reserve = path / '.reserve'  # of space: removed when the disk is full
        self._keeper: _McapKeeper | _SqliteKeeper | None = None
        self._completed = time.monotonic()
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

    @property
    def size(self) -> int:
        """Bytes on disk, metadata aside."""
        files = [file for file in self.path.glob('*') if not file.name.startswith('.')]
        sizes = 0
        for file in files:
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
            connection = self._writer.add_connection(
                topic,
                type_name,
                msgdef=definition,
                rihs01=type_hash,
                offered_qos_profiles=[offered_profile(item.qos_profile) for item in publishers],
            )
        except StorageError as error:
            self._fail(error)
            raise RecordingError(self.failure) from None
        self._topics[connection.id] = topic
        self._completed = 0.0  # SQLite would forget the topic with the transaction
        self.keep()
        return connection

    def write(self, connection: Any, stamp: int, data: bytes) -> None:
        """Write one serialized message received at `stamp` [ns since the epoch]."""
        if self.failure:
            return
        assert self._keeper is not None
        try:
            self._writer.write(connection, stamp, data)
            self._keeper.written(connection.id, stamp, data)
        except StorageError as error:
            self._fail(error)

    def keep(self) -> None:
        """Let what has been written survive a kill, every second; to be called often."""
        now = time.monotonic()
        if self.failure or self._keeper is None or now - self._completed < LONGEST_OPEN:
            return
        self._completed = now
        try:
            self._keeper.complete()
        except StorageError as error:
            self._fail(error)

    def _release(self) -> None:
        """Free the reserved space."""
        with suppress(OSError):
            self._reserve.unlink()

    def _fail(self, error: Exception) -> None:
        self.failure = f"the bag '{self.path}' cannot be written: {_reason(error)}"
        self._release()
        assert self._keeper is not None
        with suppress(*StorageError):
            self._keeper.rescue(self._writer.counts)

    def __enter__(self) -> BagWriter:
        """Make the folder and open the files in it."""
        try:
            self._writer.open()
        except FileExistsError:
            raise RecordingError(self._taken) from None
        except StorageError as error:
            raise RecordingError(
                f"the folder '{self.path}' cannot be made: {_reason(error)}"
            ) from None
        storage: Any = self._writer.storage
        self._keeper = _McapKeeper(storage) if hasattr(storage, 'bio') else _SqliteKeeper(storage)
        try:
            with self._reserve.open('xb') as file:
                os.posix_fallocate(file.fileno(), 0, RESERVE)
        except OSError as error:
            self._fail(error)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write index and metadata, also after an error: the messages stay readable."""
        self._release()
        try:
            self._close()
        except StorageError as failure:
            self.failure = (
                f"the bag '{self.path}' could not be completed ({_reason(failure)}): it has no "
                'index'
            )
            self._writer.abort()

    def _close(self) -> None:
        """Write index and metadata; bring the storage in order first, if the disk gets full."""
        try:
            self._writer.close()
        except StorageError as error:
            self._fail(error)
            self._writer.close()
