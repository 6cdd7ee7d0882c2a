"""MCAP records byte by byte, right or wrong: for files that nobody's writer would write."""

from __future__ import annotations

import struct

import zstandard

from station.episode.storage import layout
from tests.episode.synthetic import WALL_START_NS


def text(words: str) -> bytes:
    """A length and its text."""
    return struct.pack("<I", len(words)) + words.encode()


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    """A record, whose stated length may be another than its own."""
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def chunk(body: bytes, *, size: int | None = None, kind: str = "") -> bytes:
    """A chunk without a checksum, whose stated size may be another than its own."""
    head = struct.pack("<QQQI", WALL_START_NS, WALL_START_NS, len(body) if size is None else size, 0)
    return record(6, head + text(kind) + struct.pack("<Q", len(body)) + body)


def channel() -> bytes:
    """A channel record of the recorder's own bookkeeping."""
    metadata = b"".join(text(part) for part in ("writer", "recorder", "source", ""))
    body = struct.pack("<HH", 1, 0) + text(layout.STAMPS_TOPIC) + text("text")
    return record(4, body + struct.pack("<I", len(metadata)) + metadata)


def frame_that_claims(size: int) -> bytes:
    """A zstd frame whose head states a size that nothing behind it has."""
    return b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", size) + b"\x01\x00\x00"


def silent_bomb(size: int) -> bytes:
    """Zeros, compressed to next to nothing, in a frame that does not say how many."""
    return zstandard.ZstdCompressor(write_content_size=False).compress(bytes(size))
