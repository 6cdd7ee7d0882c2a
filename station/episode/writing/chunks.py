"""The records of an MCAP file while it is written: one chunk at a time, and an index that stays small.

The library's writer makes an object of every message and keeps one of every chunk until the end: 0.1 GB in an hour of
30 MB/s. Here a message is two byte strings on their way to the chunk, and a chunk leaves its 100 to 800 bytes of index,
as long as that is little; of an episode of days it is read from the file at the end.
"""

from __future__ import annotations

import struct
import zlib
from typing import Literal, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, ChunkIndex, Header, Metadata, MetadataIndex, Schema

from station.episode.storage.records import MAGIC
from station.episode.storage.tail import Index

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = 22  # bytes of a message record before its data
_MESSAGE_HEAD = _MESSAGE.size
_MESSAGE_OP = int(Opcode.MESSAGE)
_ENTRY = struct.Struct("<QQ")
_INDEX = struct.Struct("<BQHL")
_CHUNK = struct.Struct("<BQQQQL")
_LARGEST_INDEX = 32 << 20  # bytes; an hour of 60 keys has 5 MB

Compression = Literal["zstd", ""]


class Output(Protocol):
    """A file, open at its end."""

    def write(self, data: bytes, /) -> int:
        """Append bytes."""
        ...

    def tell(self) -> int:
        """Return the position that the next byte will have."""
        ...


class ChunkWriter:
    """Writes records; nothing of a chunk leaves before `end_chunk`.

    Args:
        disk: Where to.
        is_new: Whether the file is empty; else its index cannot be known here.
        compression: Of the chunks: ``zstd``, or none for what does not become smaller by it, such as pictures.

    Attributes:
        is_indexed: Whether all that the file's index must say is known here; else nothing of it is.
    """

    def __init__(self, disk: Output, *, is_new: bool = True, compression: Compression = "zstd") -> None:
        self.is_indexed = is_new
        self._disk = disk
        self._index = Index()
        self._compression = compression
        self._compressor = zstandard.ZstdCompressor(level=3) if compression else None
        self._parts: list[bytes] = []
        self._size = 0
        self._entries: dict[int, bytearray] = {}  # per channel: log time and place of each message in the chunk
        self._first_ns, self._last_ns = 1 << 63, 0

    def start(self, profile: str) -> None:
        """Write the head of a new file."""
        self._disk.write(MAGIC)
        self._disk.write(written_record(header(profile)))

    def define(self, described: Channel | Schema) -> None:
        """Put the description of a channel, or of a type of messages, into the open chunk."""
        data = written_record(described)
        self._parts.append(data)
        self._size += len(data)

    def add(
        self, channel: int, sequence: int, log_ns: int, publish_ns: int, data: bytes,
        before: bytes = b"", behind: bytes = b"",
    ) -> None:  # fmt: skip
        """Put a message into the open chunk: data and what stands around it; times in [ns], sequence in 32 bits."""
        size = len(data) + len(before) + len(behind)
        self._parts.append(_MESSAGE.pack(_MESSAGE_OP, _MESSAGE_FIELDS + size, channel, sequence, log_ns, publish_ns))
        self._parts.extend((before, data, behind) if before else (data,))
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = bytearray()
        entries += _ENTRY.pack(log_ns, self._size)
        self._size += _MESSAGE_HEAD + size
        self._first_ns = min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)

    def end_chunk(self) -> None:
        """Hand the open chunk with its message indexes to the disk; without a message it stays open."""
        if not self._entries:
            return
        data = b"".join(self._parts)
        self._parts.clear()
        packed = self._compressor.compress(data) if self._compressor else data
        offset, name = self._disk.tell(), self._compression.encode()
        length = _CHUNK.size - 9 + 4 + len(name) + 8 + len(packed)
        head = _CHUNK.pack(Opcode.CHUNK, length, self._first_ns, self._last_ns, len(data), zlib.crc32(data))
        self._disk.write(head + struct.pack("<L", len(name)) + name + struct.pack("<Q", len(packed)))
        self._disk.write(packed)
        indexes_at, places = self._disk.tell(), {}
        for channel, entries in self._entries.items():
            places[channel] = self._disk.tell()
            self._disk.write(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)))
            self._disk.write(bytes(entries))
        self._index_chunk(
            ChunkIndex(
                message_start_time=self._first_ns, message_end_time=self._last_ns, chunk_start_offset=offset,
                chunk_length=9 + length, message_index_offsets=places,
                message_index_length=self._disk.tell() - indexes_at, compression=self._compression,
                compressed_size=len(packed), uncompressed_size=len(data),
            ),
            {channel: len(entries) // _ENTRY.size for channel, entries in self._entries.items()},
        )  # fmt: skip
        self._entries, self._size = {}, 0
        self._first_ns, self._last_ns = 1 << 63, 0

    def _index_chunk(self, chunk: ChunkIndex, counts: dict[int, int]) -> None:
        if not self.is_indexed:
            return
        self._index.add(chunk, counts)
        if self._index.size > _LARGEST_INDEX:
            self.is_indexed, self._index = False, Index()

    def attach(self, name: str, media_type: str, data: bytes, at_ns: int) -> None:
        """Write an attachment before the open chunk."""
        record = written_record(Attachment(at_ns, at_ns, name, media_type, data))
        if self.is_indexed:
            self._index.attachments.append(
                AttachmentIndex(
                    offset=self._disk.tell(), length=len(record), log_time=at_ns, create_time=at_ns,
                    data_size=len(data), name=name, media_type=media_type,
                )
            )  # fmt: skip
        self._disk.write(record)

    def write_metadata(self, name: str, facts: dict[str, str]) -> None:
        """Write a metadata record before the open chunk."""
        record = written_record(Metadata(name=name, metadata=facts))
        if self.is_indexed:
            self._index.metadata.append(MetadataIndex(offset=self._disk.tell(), length=len(record), name=name))
        self._disk.write(record)

    def finish(self, schemas: list[Schema], channels: list[Channel]) -> None:
        """Write the end of a file that `is_indexed`."""
        self._disk.write(self._index.closing_bytes(schemas, channels, self._disk.tell()))


def header(profile: str) -> Header:
    """Return the header of a file of ours."""
    return Header(profile, "teleop-station")


def written_record(record: Header | Channel | Schema | Attachment | Metadata) -> bytes:
    """Return the bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    made: bytes = builder.end()
    return made
