"""The end of an MCAP file: its index, made from the records that are there.

A file whose writer was killed and went on in another process, or that is made from what is whole of a torn one, has
nobody who remembers its beginning. So its index is made anew, from the headers of the chunks and from the message
indexes behind them; nothing is decompressed.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)

from station.episode.records import MAGIC

HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQIL")
_INDEX = struct.Struct("<HL")
_FOOTER = struct.Struct("<BQQQ")
_FOOTER_LENGTH = 20
_ENTRY_SIZE = 16  # of a message index: log time and offset
_LAST_OPCODE = max(Opcode)


class Place(NamedTuple):
    """A record: what it is, where it begins, and its length with its head."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.offset + self.length


def whole_records(file: BinaryIO, size: int, start: int = len(MAGIC)) -> Iterator[Place]:
    """Iterate over the records of a file from `start` up to `size`, or to the first that is not whole.

    The caller may read in the file in between.
    """
    position = start
    while position + HEAD.size <= size:
        file.seek(position)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        place = Place(opcode, position, HEAD.size + length)
        if not 0 < opcode <= _LAST_OPCODE or place.end > size:  # zeros are blocks that were never written
            return
        yield place
        position = place.end


def body(file: BinaryIO, place: Place) -> bytes:
    """Return the bytes of a record without its head."""
    file.seek(place.offset + HEAD.size)
    return file.read(place.length - HEAD.size)


class _Index:
    """What the summary of a file says."""

    def __init__(self) -> None:
        self.chunks: list[ChunkIndex] = []
        self.attachments: list[AttachmentIndex] = []
        self.metadata: list[MetadataIndex] = []
        self.counts: Counter[int] = Counter()

    def take(self, file: BinaryIO, place: Place) -> None:
        if place.opcode == Opcode.CHUNK:
            self._take_chunk(file, place)
        elif place.opcode == Opcode.MESSAGE_INDEX:
            channel, length = _INDEX.unpack(file.read(_INDEX.size))
            self.counts[channel] += length // _ENTRY_SIZE
            self.chunks[-1].message_index_offsets[channel] = place.offset
            self.chunks[-1].message_index_length += place.length
        elif place.opcode == Opcode.ATTACHMENT:
            found = Attachment.read(ReadDataStream(BytesIO(body(file, place))))
            self.attachments.append(
                AttachmentIndex(
                    offset=place.offset,
                    length=place.length,
                    log_time=found.log_time,
                    create_time=found.create_time,
                    data_size=len(found.data),
                    name=found.name,
                    media_type=found.media_type,
                )
            )
        elif place.opcode == Opcode.METADATA:
            name = Metadata.read(ReadDataStream(BytesIO(body(file, place)))).name
            self.metadata.append(MetadataIndex(offset=place.offset, length=place.length, name=name))

    def _take_chunk(self, file: BinaryIO, place: Place) -> None:
        start_ns, end_ns, size, _, name_length = _CHUNK.unpack(file.read(_CHUNK.size))
        compression = file.read(name_length).decode("ascii", "replace")
        (compressed,) = struct.unpack("<Q", file.read(8))
        self.chunks.append(
            ChunkIndex(
                message_start_time=start_ns,
                message_end_time=end_ns,
                chunk_start_offset=place.offset,
                chunk_length=place.length,
                message_index_offsets={},
                message_index_length=0,
                compression=compression,
                compressed_size=compressed,
                uncompressed_size=size,
            )
        )

    def statistics(self, channels: int) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments), channel_count=channels, channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks), message_count=self.counts.total(), metadata_count=len(self.metadata),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0), schema_count=0,
        )  # fmt: skip


def closing_bytes(path: Path, channels: Iterable[Channel]) -> bytes:
    """Return what must be appended to a file that ends with a whole record, to make it a finished one.

    Args:
        path: The file; read, not changed.
        channels: Every channel that its chunks define.
    """
    index, size = _Index(), path.stat().st_size
    with path.open("rb") as file:
        for place in whole_records(file, size):
            index.take(file, place)
    builder = RecordBuilder()
    DataEnd(0).write(builder)
    data_end: bytes = builder.end()
    return data_end + _summary(index, list(channels), size + len(data_end)) + MAGIC


def _summary(index: _Index, channels: list[Channel], start: int) -> bytes:
    builder, offsets = RecordBuilder(), []
    groups: list[tuple[Opcode, list[Channel] | list[Statistics] | list[ChunkIndex] | list[AttachmentIndex]
                       | list[MetadataIndex]]] = [
        (Opcode.CHANNEL, channels),
        (Opcode.STATISTICS, [index.statistics(len(channels))]),
        (Opcode.CHUNK_INDEX, index.chunks),
        (Opcode.ATTACHMENT_INDEX, index.attachments),
        (Opcode.METADATA_INDEX, index.metadata),
    ]  # fmt: skip
    for opcode, records in groups:
        begin = builder.count
        for record in records:
            record.write(builder)
        if records:
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + begin, group_length=builder.count - begin)
            )
    offset_start = start + builder.count
    for offset in offsets:
        offset.write(builder)
    summary: bytes = builder.end()
    checked = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, start, offset_start), zlib.crc32(summary))
    Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=checked).write(builder)
    footer: bytes = builder.end()
    return summary + footer
