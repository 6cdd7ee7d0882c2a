"""What is whole of a torn or damaged file: chunk by chunk from its beginning, each one checked to the last bit."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, MessageIndex, Metadata, Schema

from station.episode.storage import layout
from station.episode.storage.records import MAGIC, ChunkPlace, RawMessage, parse_chunk, read_chunk
from station.episode.storage.tail import HEAD, Place, Summary, body, read_summary, whole_records
from station.errors import EpisodeError

_CHUNK = struct.Struct("<QQQIL")
_MESSAGE = struct.Struct("<HIQQ")
_LENGTH = struct.Struct("<Q")

Take = Callable[[RawMessage, Channel], None]
"""Called for each message, with its channel, in the order of the file."""


class Damage(NamedTuple):
    """A part of a file that is not whole, between others that are.

    Attributes:
        at, bytes: Where it begins, and its length.
        from_ns, to_ns: Log times of the last message before it and of the first one behind it [ns since the epoch];
            None where there is none.
        had_messages: Whether messages were in it, or may have been.
    """

    at: int
    bytes: int
    from_ns: int | None
    to_ns: int | None
    had_messages: bool


class Head(NamedTuple):
    """The records at the beginning of a file: the header, and those of its clock and its episode."""

    header: bytes
    facts: bytes


class SalvageResult(NamedTuple):
    """How far a file is whole.

    Attributes:
        channels, schemas: Every one that a whole chunk defines, by number.
        kept_to: Behind the last record that is whole; after a last chunk without its message indexes: behind the chunk.
        missing_indexes: The message indexes that the last chunk lacks, to be appended; empty when it has them.
        is_finished: Whether the file is whole to its very end, index and all.
        damages: What was left out between the parts that were kept, where the rest behind it was asked for.
        has_end: Whether nothing is missing at the end, index and all.
    """

    channels: dict[int, Channel]
    schemas: dict[int, Schema]
    kept_to: int
    missing_indexes: bytes
    is_finished: bool
    damages: tuple[Damage, ...] = ()
    has_end: bool = False


def salvage(
    path: Path, take: Take, *, size: int | None = None, output: BinaryIO | None = None, start: int = len(MAGIC),
    channels: Iterable[Channel] = (), head: Head | None = None,
) -> SalvageResult:  # fmt: skip
    """Go through a file up to the first record that is torn or damaged, or up to `size`.

    Args:
        path: The file; never changed.
        take: Gets every message of every whole chunk.
        size: Where to end at the latest; None for the length of the file.
        output: Gets a copy of what is whole, with the message indexes made anew; None for no copy.
        start: Begin at this byte, which ends a flush; what is before it is taken for whole.
        channels: What the chunks before it define.
        head: What must stand before the first chunk. With it, what is damaged is left out and the rest behind it kept,
            where something whole follows; needs an output. What a chunk that is left out defined is taken from the
            index of the file, and defined where it is first needed.

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
        walk = _Walk(file, take, output, start, channels)
        if head is not None:
            walk.keep_rest(read_summary(file, length), head)
        return walk.run(end, length)


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
        self._indexed: set[int] = set()  # channels of the last chunk
        self._owed: list[int] = []  # channels of the last chunk whose message index has not come by yet
        self._last_chunk: Place | None = None
        self._has_start = False  # whether the manifest of the start has come by
        self._kept_to = start
        self._summary: Summary | None = None  # of a file of which the rest behind a damage is kept
        self._head = Head(b"", b"")
        self._damages: list[Damage] = []
        self._last_ns: int | None = None
        self._is_behind_damage = False  # and has kept nothing since

    def keep_rest(self, summary: Summary, head: Head) -> None:
        """Go on behind what is damaged."""
        self._summary, self._head = summary, head

    def run(self, end: int, length: int) -> SalvageResult:
        self._copy(MAGIC)
        has_data_end, position = False, self._kept_to
        while True:
            for place in whole_records(self._file, end, position):
                position = place.offset
                if place.opcode == Opcode.DATA_END:
                    has_data_end = True
                    break
                if not self._keep(place):
                    break
                position = place.end
                if not self._is_behind_damage:
                    self._kept_to = position
            behind = None if has_data_end else self._next_record(position, end)
            if behind is None:
                break
            position, self._is_behind_damage = behind, True
        has_end = has_data_end and end == length and self._has_footer(length, position)
        if has_end and self._is_behind_damage:  # nothing is kept behind it, but the end is there
            self._note_damage(position, None)
        missing = b""
        if self._owed and self._last_chunk is not None:
            self._kept_to = self._last_chunk.end
            missing = _message_indexes(read_chunk(self._file, _inside(self._last_chunk)))
        is_finished = has_end and not self._damages
        return SalvageResult(
            self._channels, self._schemas, self._kept_to, missing, is_finished, tuple(self._damages), has_end
        )

    def _next_record(self, position: int, end: int) -> int | None:
        """Return where a record begins behind one that is damaged; None where none is known, or the rest is torn."""
        if self._summary is None:
            return None
        if self._summary.places:
            return next((place for place in self._summary.places if position < place < end), None)
        damaged = next(whole_records(self._file, end, position), None)
        return damaged.end if damaged is not None and damaged.end < end else None

    def _note_damage(self, to: int, first_ns: int | None) -> None:
        """Note that what lies between what was kept and a byte was left out."""
        chunks = self._summary.chunks if self._summary is not None else None
        had_messages = not chunks or any(self._kept_to <= place < to for place in chunks)
        self._damages.append(Damage(self._kept_to, to - self._kept_to, self._last_ns, first_ns, had_messages))
        self._is_behind_damage = False
        if self._last_chunk is None:  # it was in the head of the file
            self._copy(self._head.header if self._kept_to == len(MAGIC) else b"")
            self._copy(self._head.facts)
            self._head = Head(b"", b"")

    def _has_footer(self, length: int, start: int) -> bool:
        last = None
        for place in whole_records(self._file, length, start):
            last = place
            if place.opcode == Opcode.FOOTER:
                break
        self._file.seek(last.end if last else 0)
        return last is not None and last.opcode == Opcode.FOOTER and self._file.read() == MAGIC

    def _keep(self, place: Place) -> bool:
        """Read one record; False when it is damaged."""
        if self._summary is not None and self._summary.reaches_another(place):  # its length is wrong
            return False
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
        if not _is_sound(self._file, place, data, messages):
            return False
        if unknown:
            if self._summary is None or not unknown <= self._summary.channels.keys():
                return False
            data = self._defined_again(unknown) + data
        self._channels.update(defined)
        if self._is_behind_damage:
            self._note_damage(place.offset, messages[0].log_ns if messages else None)
        for message in messages:
            self._take(message, self._channels[message.channel_id])
        if messages:
            self._last_ns = max(message.log_ns for message in messages)
        self._last_chunk = place
        self._indexed = {message.channel_id for message in messages}
        if self._output is None:
            self._owed = sorted(self._indexed)
        else:
            whole = HEAD.pack(place.opcode, place.length - HEAD.size) + body(self._file, place)
            self._copy(_packed_again(body(self._file, place), data) if unknown else whole)
            self._copy(_message_indexes(data))
        return True

    def _defined_again(self, channels: set[int]) -> bytes:
        """Return the records that describe channels whose own description lay in a chunk that was left out."""
        assert self._summary is not None
        builder = RecordBuilder()
        for number in sorted(channels):
            channel = self._summary.channels[number]
            schema = self._summary.schemas.get(channel.schema_id)
            if schema is not None and self._schemas.setdefault(schema.id, schema) is schema:
                schema.write(builder)
            channel.write(builder)
            self._channels[number] = channel
        made: bytes = builder.end()
        return made

    def _keep_index(self, place: Place) -> bool:
        """Message indexes have no checksum: they must name what they belong to, and a copy gets new ones."""
        (channel,) = struct.unpack("<H", body(self._file, place)[:2])
        if self._output is not None:
            return channel in self._indexed
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
        if self._is_behind_damage:
            self._note_damage(place.offset, None)
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


def _packed_again(chunk: bytes, data: bytes) -> bytes:
    """Return a chunk record with other records than the one that it is made of, of the same times and compression."""
    old = Chunk.read(ReadDataStream(BytesIO(chunk)))
    packed = zstandard.compress(data) if old.compression else data
    builder = RecordBuilder()
    Chunk(
        compression=old.compression, data=packed, message_start_time=old.message_start_time,
        message_end_time=old.message_end_time, uncompressed_crc=zlib.crc32(data), uncompressed_size=len(data),
    ).write(builder)  # fmt: skip
    made: bytes = builder.end()
    return made


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
