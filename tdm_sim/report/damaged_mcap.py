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

"""Records of an MCAP file that was cut short or is damaged, as far as they go."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import io
from pathlib import Path
import struct
from typing import Any, BinaryIO

from mcap.exceptions import InvalidMagic
from mcap.records import Chunk, Footer
from mcap.stream_reader import breakup_chunk, StreamReader
import zstandard

LARGEST_RECORD = 2**30  # bytes; a longer one is damage

# MCAP: a record is an opcode and a length; a chunk's content follows its times, size, checksum,
# and the name of its compression.
_RECORD = struct.Struct('<BQ')
_CHUNK = struct.Struct('<QQQII')
_CHUNK_OPCODE = 0x06


def read_records(path: Path, notes: list[str]) -> Iterator[Any]:
    """
    Read records from the beginning as far as they go; blocks that are damaged are left out.

    Of a block that is cut off, the messages are read that are whole. What is lost is told in
    `notes`.
    """
    lost, complete = 0, False
    for record in _outer_records(path, notes):
        complete = complete or isinstance(record, Footer)
        if not isinstance(record, Chunk):
            yield record
            continue
        parts = _parts(record)
        lost += parts is None
        yield from parts or ()
    if lost:
        notes.append(f'{path.name}: {lost} damaged block(s) of messages were left out.')
    if not complete:
        notes.append(f'{path.name} was cut short: what was recorded last is missing.')


def _parts(chunk: Any) -> list[Any] | None:
    """Return the records in a block; None if it is damaged."""
    try:
        return list(breakup_chunk(chunk, validate_crc=True))
    except Exception:  # noqa: B902
        # The library raises many kinds for a block that is damaged.
        return None


def _outer_records(path: Path, notes: list[str]) -> Iterator[Any]:
    """Yield records, blocks as such; last the beginning of a block that is cut off."""
    begun = False
    with path.open('rb') as file:
        reader = StreamReader(file, emit_chunks=True, record_size_limit=LARGEST_RECORD)
        records = iter(reader.records)
        while True:
            read_to = file.tell()
            try:
                record = next(records, None)
            except InvalidMagic:  # of the beginning or, where there was a footer, of the end
                if not begun:
                    notes.append(f'{path.name} is not an MCAP file.')
                return
            except Exception:  # noqa: B902
                # The library raises many kinds where a file ends in the middle.
                if begun:
                    file.seek(read_to)
                    yield from _cut_block(file)
                return
            if record is None:
                return
            begun = True
            yield record


def _cut_block(file: BinaryIO) -> Iterator[Any]:
    """Yield what there is of a block that the file ends in, as a block of whole records."""
    head = file.read(_RECORD.size + _CHUNK.size)
    if len(head) < _RECORD.size + _CHUNK.size or head[0] != _CHUNK_OPCODE:
        return
    first, last, size, _, letters = _CHUNK.unpack_from(head, _RECORD.size)
    rest = file.read(LARGEST_RECORD)
    if letters > len(rest):
        return
    begin = letters + 8
    data = _decompressed(rest[begin:], rest[:letters], size)
    end = _whole(data)
    yield Chunk(
        compression='',
        data=data[:end],
        message_end_time=last,
        message_start_time=first,
        uncompressed_crc=0,
        uncompressed_size=end,
    )


def _decompressed(content: bytes, compression: bytes, size: int) -> bytes:
    """Return as much of a block's content as can be had."""
    if not compression:
        return content
    if compression != b'zstd':
        return b''
    stream = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(content))
    with suppress(zstandard.ZstdError):
        return bytes(stream.read(min(size, LARGEST_RECORD)))
    return b''


def _whole(data: bytes) -> int:
    """Return where the last record ends that is whole."""
    end = 0
    while end + _RECORD.size <= len(data):
        _, length = _RECORD.unpack_from(data, end)
        if length > len(data) - end - _RECORD.size:
            break
        end += _RECORD.size + length
    return end
