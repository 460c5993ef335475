# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Keeps a bag readable when the disk is full or the recorder is killed.

`rosbags` writes MCAP in blocks of a megabyte and SQLite in a single transaction. Here blocks are
completed and transactions committed every second, or sooner if they are large. Disk space is
reserved for what must be written at the end.
"""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
import sqlite3
from typing import Any, Protocol

RESERVE = 8 * 2**20  # bytes: a block of messages, the index of all, the metadata
LONGEST_OPEN = 1.0  # s that messages wait to be completed or committed
LARGEST_BLOCK = 2**18  # bytes of messages in a block of MCAP
MOST_OPEN = 2**20  # bytes of messages that wait in SQLite, where committing them takes longer

StorageError = (OSError, sqlite3.Error)


class Reserve:
    """Reserved space: a file of `RESERVE` bytes, removed when the disk is full."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / '.reserve'

    def take(self) -> None:
        """Reserve the space; raises OSError if there is too little."""
        with self._file.open('xb') as file:
            os.posix_fallocate(file.fileno(), 0, RESERVE)

    def release(self) -> None:
        """Free the space."""
        with suppress(OSError):
            self._file.unlink()


class Keeper(Protocol):
    """Keeps written messages readable."""

    def written(self, topic: int, stamp: int, data: bytes) -> None:
        """Note that a message has been written."""

    def complete(self) -> None:
        """Complete what has been written last, so that it survives a kill."""

    def rescue(self, counts: dict[int, int]) -> None:
        """
        Repair the storage after a failed write, with the reserve freed.

        `counts`, messages by topic, are set to those of the storage.
        """


def make_keeper(storage: Any) -> Keeper:
    """Return the keeper for a storage of `rosbags`."""
    if hasattr(storage, 'bio'):
        return _McapKeeper(storage)
    return _SqliteKeeper(storage)


class _McapKeeper:
    """Blocks of an MCAP file: a block that was written in part is cut off, and written again."""

    def __init__(self, storage: Any) -> None:
        self._storage = storage
        self._blocks = 0
        self._end = int(storage.bio.tell())

    def written(self, topic: int, stamp: int, data: bytes) -> None:
        if self._storage.chunk.bio.tell() > LARGEST_BLOCK:
            self._storage.close_chunk()
        self._note_blocks()

    def _note_blocks(self) -> None:
        if len(self._storage.chunks) != self._blocks:
            self._blocks = len(self._storage.chunks)
            self._end = int(self._storage.bio.tell())
            self._storage.bio.flush()

    def complete(self) -> None:
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
            self._note_blocks()

    def rescue(self, counts: dict[int, int]) -> None:
        file = self._storage.bio
        file.flush()
        file.seek(self._end)
        file.truncate()
        # The last message is in the open block, although writing it is what failed.
        counts.update(self._storage.channel_stats)


class _SqliteKeeper:
    """
    Transactions of a database: SQLite rolls back the open one when the disk is full.

    The messages in it are kept here until they are committed, to be written again.
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
