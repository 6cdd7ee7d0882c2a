"""The file of pictures while it is written anew, as video: the same messages in the same order, in chunks of its own.

Depth stays as it is, byte for byte: a video would round what was measured.

Each chunk begins with a key frame of every camera in it and has its own stamps, so that it is read without the others:
by whoever seeks, and after damage.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from typing import Any, NamedTuple

import mcap.records
from mcap.records import Schema

from station.episode.reading.messages import Channel, Message, channel_of
from station.episode.reading.part import Part
from station.episode.storage import layout, pictures
from station.episode.writing.chunks import ChunkWriter, Output
from station.episode.writing.file import STAMPS_NUMBER
from station.errors import EpisodeError
from station.protobuf import foxglove, schema
from station.video import JpegDecoder, VideoEncoder, in_planes, planes

_IDENTITY_BYTES = 8
_HEAD = (layout.ANCHOR_RECORD, layout.EPISODE_RECORD)


class Unfit(EpisodeError):
    """Pictures that stay JPEG files; nothing else is wrong with their episode."""


class _Waiting(NamedTuple):
    """A message of the open chunk; which picture it is, b"" for what is none."""

    message: Message
    identity: bytes


class VideoFile:
    """Takes the messages of a file of pictures in file order, raw and with their stamps.

    Args:
        file: Where to.
        old: The file of pictures, finished.
        crf: As `station.video.VideoEncoder` has it.
        gop: Most pictures of a camera in a chunk.
    """

    def __init__(self, file: Output, old: Part, *, crf: int, gop: int) -> None:
        self._old, self._crf, self._gop = old.contents, crf, gop
        self._video_type, self._picture_type = (
            _schema(1, foxglove.COMPRESSED_VIDEO),
            _schema(2, foxglove.COMPRESSED_IMAGE),
        )
        self._channels = [self._described(record) for record in old.contents.channels.values()]
        self._sizes: dict[str, tuple[int, int]] = {}
        self._decoder = JpegDecoder()
        self._encoders: dict[int, VideoEncoder] = {}
        self._counts: defaultdict[int, int] = defaultdict(int)  # of the open chunk
        self._waiting: list[_Waiting] = []
        self._writer = ChunkWriter(file)
        self._writer.start(layout.PROFILE)
        for name in _HEAD:
            self._writer.write_metadata(name, old.contents.metadata.get(name, {}))
        used = {channel.schema_id for channel in self._channels}
        self._schemas = [each for each in (self._video_type, self._picture_type) if each.id in used]
        for record in (*self._schemas, *self._channels):
            self._writer.define(record)

    def add(self, message: Message) -> None:
        """Add a message.

        Raises:
            Unfit: its picture cannot be decoded, or is not of the size of those before it.
        """
        identity = b""
        if becomes_video(message.channel):
            if self._counts[message.channel.id] == self._gop:
                self.end_chunk()
            identity = self._encode(message)
        self._waiting.append(_Waiting(message, identity))

    def end_chunk(self) -> None:
        """Write what was added since the last time."""
        packets = {number: iter(encoder.finish()) for number, encoder in self._encoders.items()}
        stamps = []
        for message, identity in self._waiting:
            number, data = message.channel.id, message.data
            if identity:
                camera = pictures.camera_of(message.topic)
                data = pictures.compressed_video(next(packets[number]), data, camera, identity)
            self._writer.add(number, message.sequence, message.log_ns, message.publish_ns, data)
            if message.stamp is not None:
                stamps.append(b"%d %b" % (number, message.stamp))
        if stamps:
            last_ns = self._waiting[-1].message.log_ns
            self._writer.add(STAMPS_NUMBER, 0, last_ns, last_ns, b"\n".join(stamps))
        self._writer.end_chunk()
        self._waiting.clear()
        self._encoders.clear()
        self._counts.clear()

    def finish(self, note: dict[str, str]) -> None:
        """Add what the old file said of itself and a note, and write the index."""
        for name, facts in self._old.metadata.items():
            if name not in _HEAD:
                self._writer.write_metadata(name, facts)
        self._writer.write_metadata(layout.COMPACTED_RECORD, note)
        if not self._writer.is_indexed:
            raise Unfit("its index would be too large")
        self._writer.finish(self._schemas, self._channels)

    def _described(self, record: mcap.records.Channel) -> mcap.records.Channel:
        if record.message_encoding != layout.PROTOBUF:
            return record
        is_video = becomes_video(channel_of(record))
        metadata = {**record.metadata, layout.VIDEO: pictures.VIDEO_FORMAT} if is_video else record.metadata
        schema_id = self._video_type.id if is_video else self._picture_type.id
        return mcap.records.Channel(record.id, record.topic, record.message_encoding, metadata, schema_id)

    def _encode(self, message: Message) -> bytes:
        """Encode a picture and return which it is."""
        number, picture = message.channel.id, self._picture(message)
        if number not in self._encoders:
            self._encoders[number] = VideoEncoder(picture.width, picture.height, crf=self._crf)
        self._encoders[number].add(picture)
        self._counts[number] += 1
        told = hashlib.blake2b(digest_size=_IDENTITY_BYTES)
        for plane in planes(picture):
            told.update(plane.data)
        return told.hexdigest().encode()

    def _picture(self, message: Message) -> Any:
        picture = self._decoder.picture(pictures.picture_in(message.data))
        where = f"{message.topic}: picture {message.sequence}"
        if picture is None:
            raise Unfit(f"{where} is no whole JPEG file")
        size = picture.width, picture.height
        if size != (first := self._sizes.setdefault(message.topic, size)):
            raise Unfit(f"{where} has {size[0]}x{size[1]} pixels, those before it {first[0]}x{first[1]}")
        if size[0] % 2 or size[1] % 2:
            raise Unfit(f"{where} has {size[0]}x{size[1]} pixels, both must be even")
        return in_planes(picture)


def becomes_video(channel: Channel) -> bool:
    """Whether a channel of a file of pictures holds what becomes video: pictures, and no depth."""
    return channel.is_typed and not channel.is_depth


def _schema(number: int, name: str) -> Schema:
    made = foxglove.schema(name)
    return Schema(id=number, name=made.name, encoding=schema.ENCODING, data=made.data)
