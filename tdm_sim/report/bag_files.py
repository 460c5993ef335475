# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Messages of a recording, whole or damaged: rosbag2 folders and single MCAP or SQLite files.

A recording that is whole is read by `rosbags`. Of one that was cut short - no metadata, no index,
half a file - everything that can still be read is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
import os
from pathlib import Path
import re
import shutil
import struct
from tempfile import TemporaryDirectory
from typing import ClassVar, NamedTuple

from mcap.records import Channel, Message, Schema
from rosbags.rosbag2 import Reader
from tdm_planner.exceptions import TdmError
from tdm_sim.report import untrusted
from tdm_sim.report.damaged_mcap import LARGEST_RECORD, read_records
import zstandard

STORAGES = ('.mcap', '.db3')
_COMPRESSED = '.zstd'
_ZSTD = b'\x28\xb5\x2f\xfd'
_SIDECARS = ('-wal', '-journal')
_LARGEST_PAGE = 65536  # of SQLite, bytes
_LARGEST_DATABASE = 2**42
_BLOCK = 2**20


class UnreadableRecording(TdmError):
    """What was given is no recording, or holds nothing a report could tell of."""

    code: ClassVar[str] = 'UNREADABLE'


class Raw(NamedTuple):
    """A message as recorded: received at `stamp` [ns]."""

    topic: str
    type_name: str
    stamp: int
    data: bytes


Wanted = Callable[[str, str], bool]
"""Whether messages of a topic and type are wanted."""


def check_recording(path: Path) -> None:
    """
    Refuse what cannot be a recording.

    Raises
    ------
    UnreadableRecording
        Saying what it is instead.

    """
    if not path.exists():
        raise UnreadableRecording(f"there is no file or folder '{path}'")
    if path.is_dir():
        if not (path / 'metadata.yaml').is_file() and not _files(path):
            raise UnreadableRecording(
                f"the folder '{path}' is no recording: it holds neither metadata.yaml nor a .mcap "
                'or .db3 file'
            )
    elif path.suffix == '.bag':
        raise UnreadableRecording(
            f"'{path}' is a bag of ROS 1: convert it first, 'rosbags-convert --src {path} --dst "
            f"{path.stem}'"
        )
    elif not _storage(path):
        raise UnreadableRecording(
            f"'{path}' is no recording: a report is made of a rosbag2 folder, a .mcap or .db3 "
            'file, or a plan (.json)'
        )


def topics(path: Path) -> dict[str, str]:
    """Return the type of every topic of a whole recording."""
    with Reader(path) as reader:
        return {connection.topic: connection.msgtype for connection in reader.connections}


def messages(path: Path, wanted: Wanted) -> Iterator[Raw]:
    """Read a whole recording; raises whatever the library does for one that is damaged."""
    if path.suffix == _COMPRESSED or _sidecars(path):
        raise UnreadableRecording(f"'{path}' must be unpacked first")
    with Reader(path) as reader:
        chosen = [c for c in reader.connections if wanted(c.topic, c.msgtype)]
        if not chosen:
            return
        for connection, stamp, data in reader.messages(chosen):
            yield Raw(connection.topic, connection.msgtype, stamp, unpacked(data))


def salvaged(path: Path, wanted: Wanted, notes: list[str]) -> Iterator[Raw]:
    """Read what is left of a damaged recording; what is lost is told in `notes`."""
    files = _files(path) if path.is_dir() else [path]
    for file in files:
        with _unpacked_file(file, notes) as plain:
            read = _salvaged_mcap if plain.suffix == '.mcap' else _salvaged_sqlite
            yield from read(plain, wanted, notes)


def unpacked(data: bytes) -> bytes:
    """Return a message, unpacked where it was compressed alone."""
    if data[:4] != _ZSTD:
        return data
    limit = zstandard.frame_content_size(data)
    if limit > LARGEST_RECORD:
        raise ValueError('a compressed message is too large')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=LARGEST_RECORD)


def _storage(path: Path) -> str:
    """Return which storage a file's name tells of; '' for none."""
    name = path.name.removesuffix(_COMPRESSED)
    return next((ending for ending in STORAGES if name.endswith(ending)), '')


def _files(folder: Path) -> list[Path]:
    """Storage files of a folder, in the order they were written."""
    found = [path for path in folder.iterdir() if path.is_file() and _storage(path)]
    return sorted(found, key=lambda path: [int(n) for n in re.findall(r'\d{1,9}', path.name)])


def _sidecars(path: Path) -> list[Path]:
    """Return what SQLite has not yet moved into a file that was not closed."""
    beside = [path.with_name(path.name + ending) for ending in _SIDECARS]
    return [file for file in beside if file.is_file() and file.stat().st_size]


@contextmanager
def _unpacked_file(path: Path, notes: list[str]) -> Iterator[Path]:
    """Return a file that can be read as it is; originals are not touched."""
    beside, size = _sidecars(path), _stated_size(path)
    if path.suffix != _COMPRESSED and not beside and size <= path.stat().st_size:
        yield path
        return
    with TemporaryDirectory(prefix='tdm_report') as folder:
        plain = Path(folder, 'recording' + _storage(path))
        if path.suffix == _COMPRESSED:
            _unpack(path, plain, notes)
        else:
            shutil.copyfile(path, plain)
        for file in beside:
            shutil.copyfile(file, plain.with_name(plain.name + file.name.removeprefix(path.name)))
        if _stated_size(plain) > plain.stat().st_size and not beside:
            # SQLite refuses a file that is too short; pages of zeros it only refuses to read.
            notes.append(f'{path.name} was cut short: what was recorded last is missing.')
            os.truncate(plain, _stated_size(plain))
        yield plain


def _stated_size(path: Path) -> int:
    """Return how long a database says it is [bytes]; 0 if it is none, or says nothing sensible."""
    with path.open('rb') as file:
        head = file.read(32)
    if len(head) < 32 or not head.startswith(b'SQLite format 3'):
        return 0
    page, count = struct.unpack('>H', head[16:18])[0], struct.unpack('>I', head[28:])[0]
    size = count * (_LARGEST_PAGE if page == 1 else page)
    return size if size < _LARGEST_DATABASE else 0


def _unpack(packed: Path, plain: Path, notes: list[str]) -> None:
    with packed.open('rb') as source, plain.open('wb') as target:
        stream = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
        try:
            while block := stream.read(_BLOCK):
                target.write(block)
        except zstandard.ZstdError:
            notes.append(f'{packed.name} is damaged: it was unpacked as far as it goes.')


def _salvaged_mcap(path: Path, wanted: Wanted, notes: list[str]) -> Iterator[Raw]:
    topics: dict[int, tuple[str, str]] = {}
    schemas: dict[int, str] = {}
    for record in read_records(path, notes):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            topics[record.id] = record.topic, schemas.get(record.schema_id, '')
        elif isinstance(record, Message) and record.channel_id in topics:
            topic, kind = topics[record.channel_id]
            if wanted(topic, kind):
                with suppress(Exception):  # of a compressed message that is damaged
                    yield Raw(topic, kind, record.log_time, unpacked(record.data))


def _salvaged_sqlite(path: Path, wanted: Wanted, notes: list[str]) -> Iterator[Raw]:
    import sqlite3

    # Copied files may be written to (SQLite puts them in order); others are left as they are.
    mode = 'mode=rw' if _sidecars(path) else 'mode=ro&immutable=1'
    try:
        database = sqlite3.connect(f'{path.absolute().as_uri()}?{mode}', uri=True)
        database.text_factory = lambda text: text.decode('utf-8', 'replace')
        rows = database.execute('SELECT id, name, type FROM topics').fetchall()
    except (sqlite3.Error, ValueError) as error:  # a message of SQLite's may not be text
        notes.append(f'{path.name} cannot be read as a database of messages ({_said(error)}).')
        return
    known = {key: (str(name), str(kind)) for key, name, kind in rows}
    chosen = [key for key, (name, kind) in known.items() if wanted(name, kind)]
    marks = ','.join('?' * len(chosen))
    query = f'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})'
    try:
        for key, stamp, data in database.execute(query, chosen):
            with suppress(Exception):  # of a compressed message that is damaged
                yield Raw(*known[key], int(stamp), unpacked(bytes(data)))
    except (sqlite3.Error, ValueError) as error:
        notes.append(f'{path.name} is damaged: messages are missing ({_said(error)}).')
    finally:
        database.close()


def _said(error: Exception) -> str:
    return untrusted.text(str(error), 100)
