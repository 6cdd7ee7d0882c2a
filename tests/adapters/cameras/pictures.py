"""Pictures that carry a number in their pixels, so that what arrived can be told from what was sent."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

_BITS = 16
Pixels = NDArray[np.uint8]


def pixels(number: int, width: int = 160, height: int = 120) -> Pixels:
    """Return a grey picture with a number as sixteen bright and dark bars, shape (height, width, 3)."""
    bits = [number >> bit & 1 for bit in range(_BITS)]
    columns = np.repeat(np.array(bits, dtype=np.uint8) * 180 + 40, width // _BITS)
    columns = np.pad(columns, (0, width - len(columns)), constant_values=40)
    return np.ascontiguousarray(np.broadcast_to(columns[None, :, None], (height, width, 3)))


def jpeg(number: int, width: int = 160, height: int = 120) -> bytes:
    """Return such a picture as a JPEG file."""
    file = io.BytesIO()
    Image.fromarray(pixels(number, width, height)).save(file, "JPEG", quality=90)
    return file.getvalue()


def yuyv(number: int, width: int = 160, height: int = 120, *, is_full_range: bool = False) -> bytes:
    """Return such a picture in packed 4:2:2, without colour."""
    luma = pixels(number, width, height)[:, :, 0].astype(np.float64)
    if not is_full_range:
        luma = luma * 219.0 / 255.0 + 16.0
    packed = np.full((height, width, 2), 128, dtype=np.uint8)
    packed[:, :, 0] = luma.round()
    return packed.tobytes()


def decoded(file: bytes) -> Pixels:
    """Return the pixels of a JPEG file."""
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB"))


def number(file: bytes) -> int:
    """Return the number that stands in a picture."""
    found = decoded(file).mean(axis=(0, 2))
    width = len(found) // _BITS
    return sum(int(found[bit * width : (bit + 1) * width].mean() > 130) << bit for bit in range(_BITS))
