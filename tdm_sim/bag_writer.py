# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Writes a rosbag2 by means of the Python package `rosbags`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
import time
from types import TracebackType
from typing import Any, ClassVar

from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from tdm_planner.exceptions import TdmError
from tdm_sim.full_disk import Keeper, LONGEST_OPEN, make_keeper, Reserve, StorageError
from tdm_sim.wire_types import definition_and_hash, offered_profile

STORAGES = ('mcap', 'sqlite3')


class RecordingError(TdmError):
    """A recording cannot be made; the message says why and what to do."""

    code: ClassVar[str] = 'RECORDING'


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
        self._reserve = Reserve(path)
        self._keeper: Keeper | None = None
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

    def _fail(self, error: Exception) -> None:
        reason = getattr(error, 'strerror', None) or str(error)
        self.failure = f"the bag '{self.path}' cannot be written: {reason}"
        self._reserve.release()
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
                f"the folder '{self.path}' cannot be made: "
                + (getattr(error, 'strerror', None) or str(error))
            ) from None
        self._keeper = make_keeper(self._writer.storage)
        try:
            self._reserve.take()
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
        self._reserve.release()
        try:
            self._close()
        except StorageError as failure:
            reason = getattr(failure, 'strerror', None) or str(failure)
            self.failure = (
                f"the bag '{self.path}' could not be completed ({reason}): it has no index"
            )
            self._writer.abort()

    def _close(self) -> None:
        """Write index and metadata; bring the storage in order first, if the disk gets full."""
        try:
            self._writer.close()
        except StorageError as error:
            self._fail(error)
            self._writer.close()
