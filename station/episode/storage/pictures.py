"""Pictures in a file: each one a ``foxglove.CompressedImage`` around the exact bytes of its key, JPEG or depth as PNG.

Of a compacted file each is a ``foxglove.CompressedVideo`` around a picture of H.264. Its field ``message_id`` tells
pictures apart that the camera told apart: two in a row have the same where their JPEG files showed the same to the last
sample. A video of a still scene may show the same for a while though the sensor's noise did not.

What stands around a picture is made by hand: the library would copy each one, and it would have to be loaded by the
recorder. Numbers of fields are those of `station.protobuf.foxglove`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

from station.bus import keys
from station.bus import stamp as stamps
from station.bus.contracts import contract
from station.episode.storage.channels import topic_of
from station.protobuf.wire import bytes_of, varint

COLOUR, DEPTH = "jpeg", "png"
"""Formats of pictures, as a contract's codec and a message have them: in colour, and depth in 16 bits."""
FORMATS = (COLOUR, DEPTH)
VIDEO_FORMAT = "h264"

DEPTH_ENDING = "_depth"
"""Of what the depth of a camera is called beside it."""

_NANOSECONDS = 1_000_000_000
_OLDEST_NS = 10 * _NANOSECONDS  # a capture that is older than this before its write is on another clock: says nothing
_SECONDS, _NANOS = b"\x08", b"\x10"  # of a time stamp
_TIMESTAMP, _DATA, _FORMAT, _FRAME_ID = b"\x0a", b"\x12", b"\x1a", b"\x22"
_DATA_NUMBER = 2
_TIMESTAMP_NUMBER, _VIDEO_NUMBER, _IDENTITY_NUMBER = 1, 3, 100
_VIDEO_FRAME_ID, _VIDEO_DATA, _VIDEO_FORMAT, _IDENTITY = b"\x12", b"\x1a", b"\x22", varint(_IDENTITY_NUMBER << 3 | 2)


@lru_cache(maxsize=4096)
def is_picture(key: str) -> bool:
    """Whether the values of a key are pictures, by its contract."""
    known = contract(key)
    return known is not None and known.codec in FORMATS


@lru_cache(maxsize=4096)
def is_depth(key: str) -> bool:
    """Whether the values of a key are depth pictures, by its contract."""
    known = contract(key)
    return known is not None and known.codec == DEPTH


def camera_of(key: str) -> str:
    """Return the name of the camera whose pictures, or depth, a key holds; one not named as ours are is its own."""
    return topic_of(key).removeprefix(keys.camera_image("")).removeprefix(keys.camera_depth(""))


def title_of(key: str) -> str:
    """Return what pictures of a key are called beside others: ``head`` in colour, ``head_depth`` for its depth."""
    camera = camera_of(key)
    return f"{camera}{DEPTH_ENDING}" if topic_of(key) == keys.camera_depth(camera) else camera


def stated(facts: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield what a server, or a manifest, states of each key of pictures: a camera's, then that of its depth.

    What is not said of the depth is as of the camera's pictures: rate, optics, mount.
    """
    yield facts
    if isinstance(depth := facts.get("depth"), Mapping):
        yield {**{name: value for name, value in facts.items() if name != "depth"}, **depth}


def captured_ns(publish_ns: int, stamp: bytes | None) -> int:
    """Return when a picture was taken, on the clock of the episode; when it was written, where its stamp does not say.

    Args:
        publish_ns: When it was written, on the clock of the episode [ns].
        stamp: The exact stamp of its write.
    """
    age_ns = stated_age_ns(stamp)
    return publish_ns - (age_ns if age_ns is not None and 0 <= age_ns < _OLDEST_NS else 0)


def stated_age_ns(stamp: bytes | None) -> int | None:
    """Return how old a picture was when it was written, by its exact stamp [ns]; None where that does not say.

    A device with a clock of its own may state anything: from a negative one on, and above `_OLDEST_NS`, its time is not
    ours.
    """
    mark = stamps.decode(stamp) if stamp is not None else None
    return None if mark is None or mark.capture_ns is None else mark.mono_ns - mark.capture_ns


def around(key: str, size: int, publish_ns: int, stamp: bytes | None) -> tuple[bytes, bytes]:
    """Return what stands before and behind a picture of a key, of so many bytes; times as in `captured_ns`."""
    return _before(captured_ns(publish_ns, stamp), size), _behind(camera_of(key), DEPTH if is_depth(key) else COLOUR)


def time_before(taken_ns: int) -> bytes:
    """Return the time stamp with which a message of a picture, or of a cloud, begins [ns since the epoch]."""
    seconds, nanos = divmod(max(0, taken_ns), _NANOSECONDS)
    time = (_SECONDS + varint(seconds) if seconds else b"") + (_NANOS + varint(nanos) if nanos else b"")
    return b"".join((_TIMESTAMP, varint(len(time)), time))


def _before(taken_ns: int, size: int) -> bytes:
    return b"".join((time_before(taken_ns), _DATA, varint(size)))


@lru_cache(maxsize=256)
def _behind(camera: str, form: str) -> bytes:
    name = camera.encode()
    return b"".join((_FORMAT, varint(len(form)), form.encode(), _FRAME_ID, varint(len(name)), name))


def compressed_image(picture: bytes, taken_ns: int, camera: str, form: str = COLOUR) -> bytes:
    """Return a whole message: a picture of a format, when it was taken [ns since the epoch], and whose it is."""
    return _before(taken_ns, len(picture)) + picture + _behind(camera, form)


def picture_in(message: bytes) -> bytes:
    """Return the picture of a message, byte for byte.

    Raises:
        ValueError: it is none.
    """
    return bytes_of(message, _DATA_NUMBER)


def compressed_video(packet: bytes, image: bytes, camera: str, identity: bytes) -> bytes:
    """Return a whole message: a picture of H.264, the time stamp of a `compressed_image`, whose it is, and which."""
    fields = (
        (_TIMESTAMP, time_in(image)), (_VIDEO_FRAME_ID, camera.encode()), (_VIDEO_DATA, packet),
        (_VIDEO_FORMAT, VIDEO_FORMAT.encode()), (_IDENTITY, identity),
    )  # fmt: skip
    return b"".join(part for tag, value in fields for part in (tag, varint(len(value)), value))


def video_in(message: bytes) -> tuple[bytes, bytes]:
    """Return the packet of a message, and which picture it is.

    Raises:
        ValueError: it is none.
    """
    return bytes_of(message, _VIDEO_NUMBER), bytes_of(message, _IDENTITY_NUMBER)


def time_in(message: bytes) -> bytes:
    """Return the time stamp of a message of either kind, as protobuf has it.

    Raises:
        ValueError: it is no message.
    """
    return bytes_of(message, _TIMESTAMP_NUMBER)
