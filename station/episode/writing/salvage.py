"""What is whole of a torn file: chunk by chunk from its beginning, each one checked to the last bit."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, MessageIndex, Metadata, Schema

from station.episode.storage import layout
from station.episode.storage.records import MAGIC, ChunkPlace, RawMessage, parse_chunk, read_chunk
from station.episode.storage.tail import HEAD, Place, body, whole_records
from station.errors import EpisodeError

_CHUNK = struct.Struct("<QQQIL")
_MESSAGE = struct.Struct("<HIQQ")
_LENGTH = struct.Struct("<Q")

Take = Callable[[RawMessage, Channel], None]
"""Called for each message, with its channel, in the order of the file."""


class SalvageResult(NamedTuple):
    """How far a file is whole.

    Attributes:
        channels, schemas: Every one that a whole chunk defines, by number.
        kept_to: Behind the last record that is whole; after a last chunk without its message indexes: behind the chunk.
        missing_indexes: The message indexes that the last chunk lacks, to be appended; empty when it has them.
        is_finished: Whether the file is whole to its very end, index and all.
    """

    channels: dict[int, Channel]
    schemas: dict[int, Schema]
    kept_to: int
    missing_indexes: bytes
    is_finished: bool


def salvage(
    path: Path, take: Take, *, size: int | None = None, output: BinaryIO | None = None, start: int = len(MAGIC),
    channels: Iterable[Channel] = (),
) -> SalvageResult:  # fmt: skip
    """Go through a file up to the first record that is torn or damaged, or up to `size`.

    Args:
        path: The file; never changed.
        take: Gets every message of every whole chunk.
        size: Where to end at the latest; None for the length of the file.
        output: Gets a copy of what is whole, with the message indexes made anew; None for no copy.
        start: Begin at this byte, which ends a flush; what is before it is taken for whole.
        channels: What the chunks before it define.

    Raises:
        OSError: the file cannot be read, or the copy not written.
        EpisodeError: it is no MCAP file.
    """
    length = path.stat().st_size
    end = length if size is None else min(size, length)
    with path.open("rb") as file:
        if (begin := file.read(len(MAGIC))) != MAGIC:
            if MAGIC.startswith(begin):  # a power cut may leave no more
                return SalvageResult({}, {}, 0, b"", is_finished=False)
            raise EpisodeError(f"{path}: not an MCAP file ({length} bytes that do not begin with its magic)")
        return _Walk(file, take, output, start, channels).run(end, length)


class _Walk:
    """One pass over a file."""

    def __init__(
        self, file: BinaryIO, take: Take, output: BinaryIO | None, start: int, channels: Iterable[Channel]
    ) -> None:
        self._file = file
        self._take = take
        self._output = output
        self._channels = {channel.id: channel for channel in channels}
        self._schemas: dict[int, Schema] = {}
        self._owed: list[int] = []  # channels of the last chunk whose message index has not come by yet
        self._last_chunk: Place | None = None
        self._has_start = False  # whether the manifest of the start has come by
        self._kept_to = start

    def run(self, end: int, length: int) -> SalvageResult:
        self._copy(MAGIC)
        has_data_end = False
        for place in whole_records(self._file, end, self._kept_to):
            if place.opcode == Opcode.DATA_END:
                has_data_end = True
                break
            if not self._keep(place):
                break
            self._kept_to = place.end
        is_finished = has_data_end and end == length and self._has_footer(length)
        missing = b""
        if self._owed and self._last_chunk is not None:
            self._kept_to = self._last_chunk.end
            missing = _message_indexes(read_chunk(self._file, _inside(self._last_chunk)))
        return SalvageResult(self._channels, self._schemas, self._kept_to, missing, is_finished)

    def _has_footer(self, length: int) -> bool:
        last = None
        for place in whole_records(self._file, length):
            last = place
            if place.opcode == Opcode.FOOTER:
                break
        self._file.seek(last.end if last else 0)
        return last is not None and last.opcode == Opcode.FOOTER and self._file.read() == MAGIC

    def _keep(self, place: Place) -> bool:
        """Read one record; False when it is damaged."""
        try:
            if place.opcode == Opcode.CHUNK:
                return self._keep_chunk(place)
            if place.opcode == Opcode.MESSAGE_INDEX:
                return self._keep_index(place)
            return self._keep_other(place)
        except (EpisodeError, EndOfFile, struct.error, ValueError, OverflowError, MemoryError):
            return False

    def _keep_chunk(self, place: Place) -> bool:
        if self._owed:  # the chunk before it must be given its indexes first
            return False
        data = read_chunk(self._file, _inside(place))
        defined: dict[int, Channel] = {}
        messages = list(parse_chunk(data, defined, self._schemas))
        unknown = {message.channel_id for message in messages} - defined.keys() - self._channels.keys()
        if unknown or not _is_sound(self._file, place, data, messages):
            return False
        self._channels.update(defined)
        for message in messages:
            self._take(message, self._channels[message.channel_id])
        self._last_chunk = place
        if self._output is None:
            self._owed = sorted({message.channel_id for message in messages})
        else:
            self._copy(HEAD.pack(place.opcode, place.length - HEAD.size) + body(self._file, place))
            self._copy(_message_indexes(data))
        return True

    def _keep_index(self, place: Place) -> bool:
        """Message indexes have no checksum: a copy gets new ones, and here they must name what they belong to."""
        if self._output is not None:
            return True
        (channel,) = struct.unpack("<H", body(self._file, place)[:2])
        if channel not in self._owed:
            return False
        self._owed.remove(channel)
        return True

    def _keep_other(self, place: Place) -> bool:
        if place.opcode not in (Opcode.HEADER, Opcode.METADATA, Opcode.ATTACHMENT) or self._owed:
            return False
        data = body(self._file, place)
        kind = {Opcode.HEADER: Header, Opcode.METADATA: Metadata, Opcode.ATTACHMENT: Attachment}[Opcode(place.opcode)]
        record, builder = kind.read(ReadDataStream(BytesIO(data))), RecordBuilder()
        record.write(builder)
        self._has_start |= isinstance(record, Attachment) and record.name == layout.MANIFEST_START
        if builder.end()[HEAD.size :] != data:  # a wrong checksum, or lengths that do not add up
            return False
        if isinstance(record, Attachment) and record.name == layout.MANIFEST:
            self._copy_manifest(record)
        else:
            self._copy(HEAD.pack(place.opcode, len(data)) + data)
        return True

    def _copy_manifest(self, record: Attachment) -> None:
        """Copy the manifest of the start under its own name; that of the end is written anew, and names are unique."""
        if self._has_start:
            return
        self._has_start, builder = True, RecordBuilder()
        record.name = layout.MANIFEST_START
        record.write(builder)
        self._copy(builder.end())

    def _copy(self, data: bytes) -> None:
        if self._output is not None:
            self._output.write(data)


def _inside(place: Place) -> ChunkPlace:
    return ChunkPlace(place.offset + HEAD.size, place.length - HEAD.size, 0, 0)


def _is_sound(file: BinaryIO, place: Place, data: bytes, messages: list[RawMessage]) -> bool:
    """Whether the fields of a chunk that its checksum does not cover are what they must be."""
    file.seek(place.offset + HEAD.size)
    start_ns, end_ns, size, _, name_length = _CHUNK.unpack(file.read(_CHUNK.size))
    file.seek(name_length, 1)
    (stored,) = _LENGTH.unpack(file.read(_LENGTH.size))
    times = [message.log_ns for message in messages]
    return (
        size == len(data)
        and _CHUNK.size + name_length + _LENGTH.size + stored == place.length - HEAD.size
        and (start_ns, end_ns) == (min(times, default=0), max(times, default=0))
    )


def _message_indexes(data: bytes) -> bytes:
    """Return the message index records of a chunk, from its uncompressed records."""
    found: dict[int, MessageIndex] = {}
    position = 0
    while position < len(data):
        opcode, length = HEAD.unpack_from(data, position)
        if opcode == Opcode.MESSAGE:
            channel, _, log_ns, _ = _MESSAGE.unpack_from(data, position + HEAD.size)
            found.setdefault(channel, MessageIndex(channel, [])).records.append((log_ns, position))
        position += HEAD.size + length
    builder = RecordBuilder()
    for index in found.values():
        index.write(builder)
    made: bytes = builder.end()
    return made
