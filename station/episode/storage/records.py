"""MCAP records straight from the file: fast, and indifferent to where a file was torn.

The library's readers show nothing of a file without its footer, and take about 15 microseconds per message. Walking
the records by their length headers takes under one, and ends at the first record that is not whole.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema, Statistics

from station.errors import EpisodeError

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQIL")  # start, end, uncompressed size, CRC, length of the compression's name
_MESSAGE_OP, _CHANNEL_OP, _SCHEMA_OP = int(Opcode.MESSAGE), int(Opcode.CHANNEL), int(Opcode.SCHEMA)
_HEAD_SIZE = 4096  # holds the header and the records of the clock and the episode many times over
# A damaged or malicious file must not make us ask for all the memory there is. The largest chunk that a recorder
# writes is its pre-roll (256 MB by default) with the largest value that a bus of ours takes (64 MiB).
_LARGEST_CHUNK = 384 << 20
_LARGEST_RECORD = 64 << 20  # outside chunks: a manifest, an index
_TIME_BITS = 63  # nanoseconds since 1970 that every reader's arithmetic takes
_BROKEN = (EndOfFile, struct.error, ValueError, OverflowError)  # what a record that is none makes its readers raise


class RawMessage(NamedTuple):
    """A message record: number of its channel, its times [ns], and its bytes."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class ChunkPlace(NamedTuple):
    """Where a chunk record lies in the file, and the first and last log time in it [ns]."""

    offset: int
    length: int
    start_ns: int
    end_ns: int


class Contents(NamedTuple):
    """What a walk over the records of a file found.

    Attributes:
        profile: Profile of its header.
        chunks: The chunks that fit into the file, in file order.
        channels: Channels that stand outside chunks (the summary of a finished file).
        attachments, metadata: By name, the last of each name.
        is_finished: Whether the footer and the closing magic are there.
        cut_at: Where the first record begins that is not whole; None when all are.
        size: Length of the file.
        counts: Number of messages by channel, as the summary of a finished file tells it; empty where none does.
    """

    profile: str
    chunks: list[ChunkPlace]
    channels: dict[int, Channel]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]
    is_finished: bool
    cut_at: int | None
    size: int
    counts: dict[int, int]


def walk(path: Path) -> Contents:
    """Read everything of a file except its messages; a torn file is read up to the tear.

    Raises:
        EpisodeError: the file cannot be read, or is no MCAP file.
    """
    try:
        with path.open("rb") as file:
            found = _walk(file, path)
            return found if found.is_finished else _without_damaged_end(file, found)
    except OSError as error:
        raise EpisodeError(f"{path}: cannot be read: {error.strerror}") from error


def _walk(file: BinaryIO, path: Path) -> Contents:
    size = path.stat().st_size
    if file.read(len(MAGIC)) != MAGIC:
        raise EpisodeError(f"{path}: not an MCAP file ({size} bytes that do not begin with its magic)")
    found = Contents("", [], {}, {}, {}, False, None, size, {})
    position = len(MAGIC)
    while position < size:
        head = file.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, size)
        end = position + _HEAD.size + length
        if end > size or opcode == 0:  # zeros are what a file system leaves of blocks it never wrote
            return found._replace(cut_at=position)
        try:
            profile = _read_record(file, opcode, length, position, found)
        except _BROKEN:
            return found._replace(cut_at=position)
        found = found if profile is None else found._replace(profile=profile)
        if opcode == Opcode.FOOTER:
            file.seek(end)
            return found._replace(is_finished=file.read() == MAGIC, cut_at=None if end + len(MAGIC) == size else end)
        file.seek(end)
        position = end
    return found


def _without_damaged_end(file: BinaryIO, found: Contents) -> Contents:
    """Leave out the last chunks of an unfinished file that have the right length and the wrong contents."""
    while found.chunks:
        try:
            read_chunk(file, found.chunks[-1])
            break
        except EpisodeError:
            found = found._replace(cut_at=found.chunks.pop().offset - _HEAD.size)
    return found


def _read_record(file: BinaryIO, opcode: int, length: int, position: int, found: Contents) -> str | None:
    """Read one record where it is of use; returns the profile when it is the header."""
    if opcode == Opcode.CHUNK:
        start_ns, end_ns, *_ = _CHUNK.unpack(file.read(_CHUNK.size))
        found.chunks.append(ChunkPlace(position + _HEAD.size, length, start_ns, end_ns))
    elif opcode in (Opcode.HEADER, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.STATISTICS):
        if length > _LARGEST_RECORD:
            raise ValueError(f"a record of {length} bytes")
        stream = ReadDataStream(BytesIO(file.read(length)))
        if opcode == Opcode.HEADER:
            profile: str = Header.read(stream).profile
            return profile
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            found.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            found.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.STATISTICS:
            found.counts.update(Statistics.read(stream).channel_message_counts)
        else:
            attachment = Attachment.read(stream)
            found.attachments[attachment.name] = attachment.data
    return None


def metadata_at_head(path: Path, name: str) -> dict[str, str]:
    """Return a metadata record from before the first chunk, reading no further; empty when there is none."""
    with path.open("rb") as file:
        head = file.read(_HEAD_SIZE)
    position = len(MAGIC)
    while head.startswith(MAGIC) and position + _HEAD.size <= len(head):
        opcode, length = _HEAD.unpack_from(head, position)
        position += _HEAD.size
        if opcode == Opcode.METADATA:
            try:
                record = Metadata.read(ReadDataStream(BytesIO(head[position : position + length])))
            except _BROKEN:
                break
            if record.name == name:
                return dict(record.metadata)
        elif opcode != Opcode.HEADER:
            break
        position += length
    return {}


def read_chunk(file: BinaryIO, place: ChunkPlace) -> bytes:
    """Return the records of a chunk, decompressed and checked.

    Raises:
        EpisodeError: the chunk is damaged, or compressed in a way we do not know.
    """
    file.seek(place.offset)
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(file.read(place.length))))
        data = _decompress(chunk)
    except (*_BROKEN, zstandard.ZstdError, MemoryError) as error:
        reason = str(error) or "it ends too early"
        raise EpisodeError(f"the chunk at byte {place.offset} is damaged: {reason}") from error
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise EpisodeError(f"the chunk at byte {place.offset} is damaged: its checksum is wrong")
    return data


def _decompress(chunk: Chunk) -> bytes:
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise ValueError(f"it claims {chunk.uncompressed_size} bytes")
    if chunk.compression == "zstd":
        # The library allocates what the frame says of itself, whatever bound it is given.
        stated = zstandard.get_frame_parameters(chunk.data).content_size
        if stated not in (chunk.uncompressed_size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError(f"it claims {chunk.uncompressed_size} bytes and {stated}")
        return zstandard.decompress(chunk.data, max(chunk.uncompressed_size, 1))
    if chunk.compression == "":
        return bytes(chunk.data)
    raise ValueError(f"it is compressed with {chunk.compression!r}, expected zstd or nothing")


def parse_chunk(
    data: bytes, channels: dict[int, Channel], schemas: dict[int, Schema] | None = None
) -> Iterator[RawMessage]:
    """Iterate over the messages of a chunk; channels that it defines are put into `channels`, schemas into `schemas`.

    Raises:
        EpisodeError: a record of it is none, or reaches beyond its end.
    """
    try:
        yield from _parse_chunk(data, channels, schemas)
    except _BROKEN as error:
        raise EpisodeError(f"a chunk holds a damaged record: {str(error) or 'it ends too early'}") from error


def _parse_chunk(data: bytes, channels: dict[int, Channel], schemas: dict[int, Schema] | None) -> Iterator[RawMessage]:
    position, size = 0, len(data)
    unpack_head, unpack_message, head_size, fixed = _HEAD.unpack_from, _MESSAGE.unpack_from, _HEAD.size, _MESSAGE.size
    while position < size:
        opcode, length = unpack_head(data, position)
        position += head_size
        end = position + length
        if end > size:
            raise ValueError(f"{length} bytes where {size - position} are left")
        if opcode == _MESSAGE_OP:
            number, sequence, log_ns, publish_ns = unpack_message(data, position)
            if (log_ns | publish_ns) >> _TIME_BITS:
                raise ValueError("a time of a message is beyond the year 2262")
            yield RawMessage(number, sequence, log_ns, publish_ns, data[position + fixed : end])
        elif opcode == _CHANNEL_OP:
            channel = Channel.read(ReadDataStream(BytesIO(data[position:end])))
            channels[channel.id] = channel
        elif opcode == _SCHEMA_OP and schemas is not None:
            schema = Schema.read(ReadDataStream(BytesIO(data[position:end])))
            schemas[schema.id] = schema
        position = end
