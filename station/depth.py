"""A depth picture as bytes: a PNG file with one channel of 16 bits, in steps of a stated length; 0 means: no depth.

Depth is the distance along the optical axis, not along the ray. PNG keeps every step; Foxglove and Rerun read it.
"""

from __future__ import annotations

import io
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.contract import DEPTH_STEP_M
from station.protocols import Floats, Floats32

Steps = NDArray[np.uint16]
"""Depth in steps, shape (height, width); 0 where nothing was measured."""

_MOST = 65535  # steps
_MOST_PIXELS = 40_000_000  # of a picture that is opened; a camera has half a million to 2 million
_LEVEL = 1
"""Of zlib, up to 9. For 640x480 of a simulated eye 1 takes 4 ms and 11 kB, of the noise of a sensor 12 ms and 250 kB;
6 makes the latter 7 % smaller in 80 ms."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEAD_BYTES = 13
_GREY, _BITS, _WHOLE_ROWS = 0, 16, 0  # colour type, bits of a channel, no interlace


class Head(NamedTuple):
    """Size of a picture [px]."""

    width: int
    height: int


def head(data: bytes) -> Head | None:
    """Return what the head of a whole depth picture tells, or None for anything else.

    Whole is a PNG file of one channel of 16 bits in which every chunk is there and has its checksum, up to the last.
    """
    if not data.startswith(_SIGNATURE):
        return None
    at, found, has_pixels = len(_SIGNATURE), None, False
    while at + 12 <= len(data):
        size, kind = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        end = at + 8 + size
        if end + 4 > len(data) or zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4]):
            return None
        if found is None:
            found = _size(data[at + 8 : end]) if kind == b"IHDR" else None
            if found is None:
                return None
        has_pixels = has_pixels or kind == b"IDAT"
        if kind == b"IEND":
            return found if has_pixels else None
        at = end + 4
    return None


def encoded(steps: Steps) -> bytes:
    """Return the file of a picture, shape (height, width)."""
    from PIL import Image

    made = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(steps, dtype=np.uint16)).save(made, format="PNG", compress_level=_LEVEL)
    return made.getvalue()


def decoded(data: bytes) -> Steps | None:
    """Return the picture of a file; None for what is no whole depth picture, or larger than any camera's."""
    from PIL import Image

    known = head(data)
    if known is None or known.width * known.height > _MOST_PIXELS:
        return None
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as picture:
            return np.asarray(picture).astype(np.uint16)
    except (OSError, ValueError, SyntaxError, zlib.error, Image.DecompressionBombError):  # Pillow, of broken bytes
        return None


def of_metres(depth_m: Floats | Floats32, *, farthest_m: float) -> Steps:
    """Return depths [m] in steps of `DEPTH_STEP_M`, to the nearest; what is beyond the range, or no number, is 0."""
    is_seen = (depth_m > 0.0) & (depth_m <= min(farthest_m, _MOST * DEPTH_STEP_M))
    return np.rint(np.where(is_seen, depth_m, 0.0) / DEPTH_STEP_M).astype(np.uint16)


def rescaled(steps: Steps, step_m: float) -> Steps:
    """Return depths of another step [m] in steps of `DEPTH_STEP_M`, to the nearest; what is too far for them is 0."""
    if abs(step_m - DEPTH_STEP_M) < 1e-9:
        return steps
    found = np.rint(steps.astype(np.float32) * np.float32(step_m / DEPTH_STEP_M))
    return np.where(found <= _MOST, found, 0).astype(np.uint16)


def in_metres(steps: Steps, step_m: float) -> Floats32:
    """Return depths in metres, float32; 0 where nothing was measured."""
    return steps.astype(np.float32) * np.float32(step_m)


def _size(body: bytes) -> Head | None:
    """Return the size that the first chunk states; None where that is of no depth picture."""
    if len(body) != _HEAD_BYTES or (body[8], body[9], body[12]) != (_BITS, _GREY, _WHOLE_ROWS):
        return None
    width, height = int.from_bytes(body[:4]), int.from_bytes(body[4:8])
    return Head(width, height) if width and height else None
