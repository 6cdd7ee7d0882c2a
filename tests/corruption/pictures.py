"""Pictures of an episode as a stranger reads and writes them: files in ``foxglove.CompressedImage`` messages."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import simplejpeg
from PIL import Image as Picture

from tests.corruption.files import ONE_S, DoesNotFit, Episode, Message, Stream

PREFIX, DEPTH_PREFIX = "camera_image_", "camera_depth_"
_QUALITY = 90
_TIMESTAMP, _DATA = 1, 2  # numbers of the fields
_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5  # wire types

Image = np.ndarray


def camera_name(stream: Stream) -> str:
    return stream.key.removeprefix(PREFIX).removeprefix(DEPTH_PREFIX)


def cameras(episode: Episode, least: int = 1) -> list[Stream]:
    """Return the streams of pictures, by name of the camera.

    Raises:
        DoesNotFit: there are fewer than `least`.
    """
    found = [stream for key, stream in sorted(episode.streams(episode.cameras).items()) if key.startswith(PREFIX)]
    if len(found) < least:
        raise DoesNotFit(f"{len(found)} cameras")
    return found


def depth(episode: Episode) -> Stream:
    """Return the stream of depth of the first camera that has it.

    Raises:
        DoesNotFit: none has.
    """
    streams = sorted(episode.streams(episode.cameras).items())
    found = next((stream for key, stream in streams if key.startswith(DEPTH_PREFIX)), None)
    if found is None:
        raise DoesNotFit("no depth")
    return found


def is_picture(key: str) -> bool:
    return key.startswith((PREFIX, DEPTH_PREFIX))


def no_depth(width: int, height: int) -> bytes:
    """Return a depth picture in which nothing was measured."""
    stream = io.BytesIO()
    Picture.fromarray(np.zeros((height, width), np.uint16)).save(stream, "PNG")
    return stream.getvalue()


def jpeg_of(message: Message) -> bytes:
    return next(payload for number, payload, _ in _fields(message.data) if number == _DATA)


def put_jpeg(message: Message, jpeg: bytes) -> None:
    """Put another JPEG file into a message; everything around it stays."""
    message.data = b"".join(
        _field(_DATA, jpeg) if number == _DATA else whole for number, _, whole in _fields(message.data)
    )


def move_capture(message: Message, ns: int) -> None:
    """Say that a picture was taken so many nanoseconds later, in the message; its stamp says it apart."""
    parts = []
    for number, payload, whole in _fields(message.data):
        if number == _TIMESTAMP:
            values = {inner: int.from_bytes(text, "little") for inner, text, _ in _fields(payload)}
            seconds, nanos = divmod(values.get(1, 0) * ONE_S + values.get(2, 0) + ns, ONE_S)
            parts.append(_field(_TIMESTAMP, b"\x08" + _varint(seconds) + b"\x10" + _varint(nanos)))
        else:
            parts.append(whole)
    message.data = b"".join(parts)


def decoded(message: Message) -> Image:
    """Return a picture, shape (height, width, 3), RGB."""
    return simplejpeg.decode_jpeg(jpeg_of(message))


def encoded(image: Image) -> bytes:
    return simplejpeg.encode_jpeg(
        np.ascontiguousarray(np.clip(image, 0, 255).astype(np.uint8)), _QUALITY, colorsubsampling="420"
    )


def change(messages: list[Message], how: Callable[[Image], Image]) -> None:
    """Decode pictures, change them, and encode them again."""
    for message in messages:
        put_jpeg(message, encoded(how(decoded(message))))


def blurred(image: Image, radius: int) -> Image:
    """Return the mean over a square of 2 radius + 1 pixels."""
    size = 2 * radius + 1
    padded = np.pad(image.astype(float), ((radius + 1, radius), (radius + 1, radius), (0, 0)), mode="edge")
    sums = padded.cumsum(0).cumsum(1)
    whole = sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size]
    return whole / size**2


def resized(image: Image, height: int, width: int) -> Image:
    rows = np.arange(height) * image.shape[0] // height
    columns = np.arange(width) * image.shape[1] // width
    return image[rows][:, columns]


def _fields(data: bytes) -> list[tuple[int, bytes, bytes]]:
    """Return number, payload and whole of each field of a protobuf message; a varint as little-endian bytes."""
    found, position = [], 0
    while position < len(data):
        begin = position
        tag, position = _read_varint(data, position)
        kind = tag & 7
        if kind == _VARINT:
            value, position = _read_varint(data, position)
            payload = value.to_bytes(8, "little")
        else:
            length = {_FIXED64: 8, _FIXED32: 4}.get(kind)
            if kind == _LENGTH:
                length, position = _read_varint(data, position)
            if length is None:
                raise ValueError(f"wire type {kind}")
            payload = data[position : position + length]
            position += length
        found.append((tag >> 3, payload, data[begin:position]))
    return found


def _read_varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        value |= (byte & 0x7F) << shift
        position, shift = position + 1, shift + 7
        if byte < 0x80:
            return value, position


def _varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    found.append(value)
    return bytes(found)


def _field(number: int, payload: bytes) -> bytes:
    return _varint(number << 3 | _LENGTH) + _varint(len(payload)) + payload
