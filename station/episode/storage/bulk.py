"""In which file of an episode a key is, and what stands around its values there: pictures and clouds have their own."""

from __future__ import annotations

from functools import lru_cache

from station.bus.contracts import contract
from station.episode.storage import layout, pictures
from station.protobuf import wire

CLOUD = "point-cloud"
"""Codec of clouds, in a contract."""


@lru_cache(maxsize=4096)
def names_of(key: str) -> layout.Names:
    """Return what the file is called that the values of a key are in, by its contract."""
    known = contract(key)
    if known is None:
        return layout.SIGNALS_NAMES
    if known.codec == CLOUD:
        return layout.CLOUDS_NAMES
    return layout.CAMERAS_NAMES if known.codec in pictures.FORMATS else layout.SIGNALS_NAMES


def around(key: str, size: int, publish_ns: int, stamp: bytes | None) -> tuple[bytes, bytes]:
    """Return what stands before and behind a picture or a cloud; as `station.episode.storage.pictures.around`."""
    if names_of(key) is layout.CLOUDS_NAMES:
        return pictures.time_before(pictures.captured_ns(publish_ns, stamp)), b""
    return pictures.around(key, size, publish_ns, stamp)


def value_in(message: bytes, file: str) -> bytes:
    """Return the picture or the cloud of a message of a file, byte for byte.

    Raises:
        ValueError: it is none.
    """
    return _without_time(message) if file == layout.CLOUDS else pictures.picture_in(message)


def _without_time(message: bytes) -> bytes:
    number, _, _, end = next(wire.fields(message), (0, 0, 0, 0))
    if number != 1:
        raise ValueError("no time stands before the cloud")
    return message[end:]
