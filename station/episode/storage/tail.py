"""The end of an MCAP file: its index, made from the records that are there.

A file whose writer was killed and went on in another process, or that is made from what is whole of a torn one, has
no process that remembers its beginning. So its index is made anew, from the headers of the chunks and from the message
indexes behind them; nothing is decompressed.
"""

from __future__ import annotations

import bisect
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
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
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from station.episode.storage.records import MAGIC

HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQIL")
_INDEX = struct.Struct("<HL")
_FOOTER = struct.Struct("<BQQQ")
_WHOLE_FOOTER = struct.Struct("<BQQQL")
_FOOTER_LENGTH = 20
_DATA_END_SIZE = HEAD.size + 4
_ENTRY_SIZE = 16  # of a message index: log time and offset
_LAST_OPCODE = max(Opcode)
_RECORD_SIZE = 200  # bytes of memory of a small one, roughly


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


class Summary(NamedTuple):
    """What the end of a file tells of its records.

    Attributes:
        places: Where chunks, attachments and metadata begin, and where the end of the data does; in order.
        chunks: Which of those are chunks.
        channels, schemas: What describes them, by number.
    """

    places: list[int]
    chunks: set[int]
    channels: dict[int, Channel]
    schemas: dict[int, Schema]

    def reaches_another(self, place: Place) -> bool:
        """Whether a record would end behind the beginning of another one."""
        following = bisect.bisect_right(self.places, place.offset)
        return following < len(self.places) and place.end > self.places[following]


class FoundFooter(NamedTuple):
    """The last record of a whole file: where it is, where the summary and its offsets begin, and their checksum."""

    at: int
    summary_start: int
    offsets_start: int
    summary_crc: int


def read_footer(file: BinaryIO, size: int) -> FoundFooter | None:
    """Read the footer of a file; None of one that does not end with it, or has no summary."""
    at = size - _WHOLE_FOOTER.size - len(MAGIC)
    if at < len(MAGIC):
        return None
    file.seek(at)
    data = file.read(_WHOLE_FOOTER.size + len(MAGIC))
    opcode, length, start, offsets, crc = _WHOLE_FOOTER.unpack_from(data)
    is_ours = (opcode, length) == (Opcode.FOOTER, _FOOTER_LENGTH) and data.endswith(MAGIC)
    return FoundFooter(at, start, offsets, crc) if is_ours and len(MAGIC) < start < at else None


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Read the summary of a file; of one that has none, or a damaged one, an empty one."""
    found, footer = Summary([], set(), {}, {}), read_footer(file, size)
    if footer is None:
        return found
    start = footer.summary_start
    file.seek(start)
    head = _FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, start, footer.offsets_start)
    if zlib.crc32(head, zlib.crc32(file.read(footer.at - start))) != footer.summary_crc:
        return found
    for place in whole_records(file, footer.at, start):
        record = ReadDataStream(BytesIO(body(file, place)))
        if place.opcode == Opcode.CHANNEL:
            channel = Channel.read(record)
            found.channels[channel.id] = channel
        elif place.opcode == Opcode.SCHEMA:
            schema = Schema.read(record)
            found.schemas[schema.id] = schema
        elif place.opcode == Opcode.CHUNK_INDEX:
            found.chunks.add(ChunkIndex.read(record).chunk_start_offset)
        elif place.opcode == Opcode.ATTACHMENT_INDEX:
            found.places.append(AttachmentIndex.read(record).offset)
        elif place.opcode == Opcode.METADATA_INDEX:
            found.places.append(MetadataIndex.read(record).offset)
    found.places.extend((*found.chunks, start - _DATA_END_SIZE))
    found.places.sort()
    return found


class Index:
    """What the summary of a file says.

    The chunks' part is kept as the bytes that the file will have: there are tens of thousands in an hour.

    Attributes:
        attachments, metadata: Where those records are.
    """

    def __init__(self) -> None:
        self.attachments: list[AttachmentIndex] = []
        self.metadata: list[MetadataIndex] = []
        self._chunks = bytearray()
        self._chunk_count = 0
        self._span_ns: tuple[int, int] | None = None
        self._counts: Counter[int] = Counter()
        self._open: ChunkIndex | None = None  # of a file that is read: its message indexes follow the chunk

    @property
    def size(self) -> int:
        """Bytes of memory that it takes, roughly."""
        return len(self._chunks) + _RECORD_SIZE * (len(self.attachments) + len(self.metadata))

    def add(self, chunk: ChunkIndex, counts: Mapping[int, int]) -> None:
        """Add a chunk, and how many messages of each channel it holds."""
        builder = RecordBuilder()
        chunk.write(builder)
        self._chunks += builder.end()
        self._chunk_count += 1
        start_ns, end_ns = self._span_ns or (chunk.message_start_time, chunk.message_end_time)
        self._span_ns = min(start_ns, chunk.message_start_time), max(end_ns, chunk.message_end_time)
        for channel, count in counts.items():
            self._counts[channel] += count

    def on_record(self, file: BinaryIO, place: Place) -> None:
        """Add a record of a file that is read through."""
        if place.opcode == Opcode.CHUNK:
            self._add_chunk(file, place)
        elif place.opcode == Opcode.MESSAGE_INDEX and self._open is not None:
            channel, length = _INDEX.unpack(file.read(_INDEX.size))
            self._counts[channel] += length // _ENTRY_SIZE
            self._open.message_index_offsets[channel] = place.offset
            self._open.message_index_length += place.length
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

    def closing_bytes(self, schemas: Sequence[Schema], channels: Sequence[Channel], size: int) -> bytes:
        """Return what must be appended to a file of so many bytes, all of them noted, to make it a finished one."""
        self._end_chunk()
        builder = RecordBuilder()
        DataEnd(0).write(builder)
        data_end: bytes = builder.end()
        return data_end + self._summary(schemas, channels, size + len(data_end)) + MAGIC

    def _add_chunk(self, file: BinaryIO, place: Place) -> None:
        self._end_chunk()
        start_ns, end_ns, size, _, name_length = _CHUNK.unpack(file.read(_CHUNK.size))
        compression = file.read(name_length).decode("ascii", "replace")
        (compressed,) = struct.unpack("<Q", file.read(8))
        self._open = ChunkIndex(
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

    def _end_chunk(self) -> None:
        if self._open is not None:
            self.add(self._open, {})
            self._open = None

    def _statistics(self, schemas: int, channels: int) -> Statistics:
        start_ns, end_ns = self._span_ns or (0, 0)
        return Statistics(
            attachment_count=len(self.attachments), channel_count=channels, channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count, message_count=self._counts.total(), metadata_count=len(self.metadata),
            message_start_time=start_ns, message_end_time=end_ns, schema_count=schemas,
        )  # fmt: skip

    def _summary(self, schemas: Sequence[Schema], channels: Sequence[Channel], start: int) -> bytes:
        builder, offsets = RecordBuilder(), []
        groups: list[tuple[Opcode, bytes | bytearray]] = [
            (Opcode.SCHEMA, _written(schemas)),
            (Opcode.CHANNEL, _written(channels)),
            (Opcode.STATISTICS, _written([self._statistics(len(schemas), len(channels))])),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, _written(self.attachments)),
            (Opcode.METADATA_INDEX, _written(self.metadata)),
        ]
        for opcode, records in groups:
            if records:
                group = SummaryOffset(group_opcode=opcode, group_start=start + builder.count, group_length=len(records))
                offsets.append(group)
            builder.write(records)
        offset_start = start + builder.count
        builder.write(_written(offsets))
        summary: bytes = builder.end()
        checked = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, start, offset_start), zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=checked)
        return summary + _written([footer])


def closing_bytes(path: Path, schemas: Sequence[Schema], channels: Sequence[Channel]) -> bytes:
    """Return what must be appended to a file that ends with a whole record, to make it a finished one.

    Args:
        path: The file; read, not changed.
        schemas, channels: Every one that its chunks define.
    """
    index, size = Index(), path.stat().st_size
    with path.open("rb") as file:
        for place in whole_records(file, size):
            index.on_record(file, place)
    return index.closing_bytes(schemas, channels, size)


def _written(records: Sequence[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    made: bytes = builder.end()
    return made
