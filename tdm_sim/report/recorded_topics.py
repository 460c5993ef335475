# Copyright 2026 The tdm_planner authors
# SPDX-License-Identifier: Apache-2.0

"""
Topics of a recording, whole or damaged: of rosbag2 folders and single MCAP or SQLite files.

Of a recording that was cut short - no metadata, no index, half a file - what comes before the
damage is read.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from operator import itemgetter
import os
from pathlib import Path
import re
import shutil
import sqlite3
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.typesys import get_typestore, Stores
from tdm_planner.nodes.reading import nanoseconds_of
from tdm_planner.plan_files import UnusableFile
from tdm_planner.trajectory import SECOND
from tdm_sim.report import untrusted
import zstandard

JOINT_STATE = 'sensor_msgs/msg/JointState'
ODOMETRY = 'nav_msgs/msg/Odometry'
PLAN = 'trajectory_msgs/msg/JointTrajectory'
STRING = 'std_msgs/msg/String'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
STATUSES = 'action_msgs/msg/GoalStatusArray'
_CLOCK = 'rosgraph_msgs/msg/Clock'

_WANTED = (JOINT_STATE, ODOMETRY, PLAN, DIAGNOSTICS, STATUSES, _CLOCK)

STORAGES = ('.mcap', '.db3')
_COMPRESSED = '.zstd'
_ZSTD = b'\x28\xb5\x2f\xfd'
_LONGEST = 2**30  # bytes of a record or a message; a longer one is damage
_UNDER_WAY = SECOND // 10  # ns that a message may take: those before the clock was set back

Wanted = Callable[[str, str], bool]  # whether messages of a topic and type are
Raw = tuple[str, str, int, bytes]  # topic, type, instant of its recording [ns], message


def wanted(topic: str, kind: str) -> bool:
    """Whether a report has a use for a topic."""
    if kind == STRING:
        return topic.rsplit('/', 1)[-1] == 'plan_summary'
    return kind in _WANTED


class Received(NamedTuple):
    """A message, and when it was recorded [ns]."""

    message: Any
    stamp: int

    @property
    def instant(self) -> int:
        """When it was sent [ns]; a stamp of zero means now, as usual in ROS: when it came."""
        return nanoseconds_of(self.message.header.stamp) or self.stamp


@dataclass(eq=False)
class Topic:
    """
    What was recorded of a topic: messages as they were sent, and when they were recorded [ns].

    `malformed` counts those that are none of its type, `strange` those that do not tell what they
    should.
    """

    kind: str
    recorded: list[tuple[int, bytes]] = field(default_factory=list)
    malformed: int = 0
    strange: int = 0


class RecordedTopics(dict[str, Topic]):
    """A recording by topic; `seen` are the names of all topics, `begun` [ns] when it began."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[str] = set()
        self.begun = 2**63
        self._store = get_typestore(Stores.ROS2_JAZZY)

    @property
    def real_time(self) -> bool:
        """Whether the stamps of messages are the recorder's time."""
        return '/clock' not in self.seen

    def of_type(self, kind: str) -> Iterator[tuple[str, Received]]:
        """Yield the messages of every topic of a type, with the topic's name."""
        for name in self:
            for received in self.messages(name, kind):
                yield name, received

    def first(self, name: str, kind: str) -> Any:
        """Return the first message of a topic; None if there is none of this type."""
        return next((received.message for received in self.messages(name, kind)), None)

    def messages(self, name: str, kind: str) -> Iterator[Received]:
        """Yield the messages of a topic as they were recorded; none if it is not of this type."""
        topic, malformed = self.get(name), 0
        if topic is None or topic.kind != kind:
            return
        for stamp, data in topic.recorded:
            try:
                message = self._store.deserialize_cdr(data, kind)
            except Exception:  # noqa: B902
                # The library raises many kinds for bytes that are not such a message.
                malformed += 1
            else:
                yield Received(message, stamp)
        topic.malformed = malformed


def read_topics(path: Path, notes: list[str]) -> RecordedTopics:
    """
    Read a recording as far as it can be read; `notes` say what is lost of a damaged one.

    Of a simulation it is told in simulated time, by /clock, when messages were recorded.

    Raise UnusableFile for what cannot be a recording, saying what it is instead.
    """
    check_recording(path)
    topics = RecordedTopics()

    def noted(name: str, kind: str) -> bool:
        topics.seen.add(name)
        return wanted(name, kind)

    for name, kind, stamp, data in _messages(path, noted, notes):
        topic = topics.setdefault(name, Topic(kind))
        topics.begun = min(topics.begun, stamp)
        topic.recorded.append((stamp, data))
    for topic in topics.values():
        topic.recorded.sort(key=itemgetter(0))  # a file need not be in order
    ticks = [(t.stamp, nanoseconds_of(t.message.clock)) for t in topics.messages('/clock', _CLOCK)]
    anew = [at for (_, last), (at, now) in pairwise(ticks) if now < last - SECOND]
    if anew:
        notes.append('Simulated time was set back: what was recorded before that is not shown.')
    for topic in topics.values():
        told = [one for one in topic.recorded if not anew or one[0] >= anew[-1] + _UNDER_WAY]
        if ticks:
            last = [max(bisect_left(ticks, (stamp + 1,)) - 1, 0) for stamp, _ in told]
            told = [(ticks[k][1], data) for k, (_, data) in zip(last, told, strict=True)]
        topic.recorded = told
    return topics


def check_recording(path: Path) -> None:
    """Raise UnusableFile for what cannot be a recording, saying what it is instead."""
    if not path.exists():
        raise UnusableFile(f"there is no file or folder '{path}'")
    if path.is_dir():
        if not (path / 'metadata.yaml').is_file() and not _files(path):
            raise UnusableFile(
                f"the folder '{path}' is no recording: it holds neither metadata.yaml nor a .mcap "
                'or .db3 file'
            )
    elif path.suffix == '.bag':
        raise UnusableFile(
            f"'{path}' is a bag of ROS 1: convert it first, 'rosbags-convert --src {path} --dst "
            f"{path.stem}'"
        )
    elif not _storage(path):
        raise UnusableFile(
            f"'{path}' is no recording: a report is made of a rosbag2 folder, a .mcap or .db3 "
            'file, or a plan as .json, which alone holds its problem and its check'
        )


def _messages(path: Path, wanted: Wanted, notes: list[str]) -> Iterator[Raw]:
    """Read a recording as far as it can be read; `notes` say what is lost of a damaged one."""
    for file in _files(path) if path.is_dir() else [path]:
        with TemporaryDirectory(prefix='tdm_report') as folder:
            try:
                plain = _readable(file, Path(folder), notes)
                if plain.suffix == '.mcap':
                    yield from _of_mcap(plain, wanted)
                else:
                    yield from _of_sqlite(plain, wanted, untouched=plain == file)
            except OSError as error:
                notes.append(f'{file.name} cannot be read: {error.strerror}.')
            except Exception as error:  # noqa: B902
                # The libraries raise many kinds where a file ends in the middle.
                notes.append(
                    f'{file.name} is damaged or was cut short: messages are missing '
                    f'({untrusted.text(str(error), 100)}).'
                )


def _unpacked(data: bytes) -> bytes:
    if data[:4] != _ZSTD:
        return data
    if zstandard.frame_content_size(data) > _LONGEST:
        raise ValueError('a compressed message is too large')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=_LONGEST)


def _storage(path: Path) -> str:
    name = path.name.removesuffix(_COMPRESSED)
    return next((ending for ending in STORAGES if name.endswith(ending)), '')


def _files(folder: Path) -> list[Path]:
    """Storage files of a folder, in the order they were written; no copies of one another."""
    found = [path for path in folder.iterdir() if path.is_file() and _storage(path)]
    metadata = folder / 'metadata.yaml'
    told = metadata.read_text(encoding='utf-8', errors='replace') if metadata.is_file() else ''
    found = [path for path in found if path.name in told] or found
    packed = {path.name + _COMPRESSED for path in found}
    found = [path for path in found if path.name not in packed]
    return sorted(found, key=lambda path: [int(n) for n in re.findall(r'\d{1,9}', path.name)])


def _readable(path: Path, folder: Path, notes: list[str]) -> Path:
    """Return a file that can be read as it is, or a copy in `folder` of one that cannot."""
    plain = folder / f'recording{_storage(path)}'
    if path.suffix == _COMPRESSED:
        with path.open('rb') as source, plain.open('wb') as target:
            stream = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
            try:
                shutil.copyfileobj(stream, target)
            except zstandard.ZstdError:
                notes.append(f'{path.name} is damaged: it was unpacked as far as it goes.')
        return plain
    if path.suffix == '.mcap':
        return path
    # SQLite cannot open a file that is too short; it opens, but cannot read, pages of zeros.
    with path.open('rb') as database:
        head = database.read(32).ljust(32, b'\0')
    stated = int.from_bytes(head[16:18], 'big') * int.from_bytes(head[28:], 'big')
    short = path.stat().st_size < stated < _LONGEST
    # what SQLite has not yet moved into the file
    beside = {end: path.with_name(path.name + end) for end in ('-wal', '-journal')}
    if not short and not any(file.is_file() for file in beside.values()):
        return path
    shutil.copyfile(path, plain)
    for end, file in beside.items():
        if file.is_file():
            shutil.copyfile(file, plain.with_name(plain.name + end))
    if short:
        os.truncate(plain, stated)
    return plain


def _of_mcap(path: Path, wanted: Wanted) -> Iterator[Raw]:
    topics: dict[int, tuple[str, str]] = {}
    schemas: dict[int, str] = {}
    with path.open('rb') as file:
        for record in StreamReader(file, record_size_limit=_LONGEST).records:
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                told = record.topic, schemas.get(record.schema_id, '')
                topics |= {record.id: told} if wanted(*told) else {}
            elif isinstance(record, Message) and record.channel_id in topics:
                with suppress(zstandard.ZstdError, ValueError):  # of a compressed message
                    data = _unpacked(record.data)
                    yield *topics[record.channel_id], record.log_time, data


def _of_sqlite(path: Path, wanted: Wanted, untouched: bool) -> Iterator[Raw]:
    """Read a database; one that is `untouched` gets no files beside it."""
    address = f'{path.absolute().as_uri()}?immutable={int(untouched)}'
    with closing(sqlite3.connect(address, uri=True)) as database:
        database.text_factory = lambda text: text.decode('utf-8', 'replace')
        rows = database.execute('SELECT id, name, type FROM topics').fetchall()
        known = {key: (str(name), str(kind)) for key, name, kind in rows}
        chosen = [key for key, (name, kind) in known.items() if wanted(name, kind)]
        marks = ','.join('?' * len(chosen))
        query = f'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})'
        for key, stamp, data in database.execute(query, chosen):
            with suppress(zstandard.ZstdError, ValueError):  # of a compressed message
                yield *known[key], int(stamp), _unpacked(bytes(data))
