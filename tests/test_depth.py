"""Depth pictures as bytes: every step comes back, and what is no whole one is told from its bytes alone."""

from __future__ import annotations

import io
import zlib

import numpy as np
import pytest
from PIL import Image

from station import depth
from tests.export.pictured import jpeg

WIDTH, HEIGHT = 64, 48


def room(farthest: int = 65535) -> depth.Steps:
    """A slope with a hole in it, from 1 to the most that a picture can hold."""
    steps = np.linspace(1, farthest, WIDTH * HEIGHT).reshape(HEIGHT, WIDTH).astype(np.uint16)
    steps[10:20, 10:20] = 0
    return steps


def png(picture: Image.Image, **options: object) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, "PNG", **options)
    return stream.getvalue()


def test_every_step_comes_back() -> None:
    file = depth.encoded(room())
    assert depth.head(file) == (WIDTH, HEIGHT)
    found = depth.decoded(file)
    assert found is not None
    assert found.dtype == np.uint16
    assert (found == room()).all()
    with Image.open(io.BytesIO(file)) as seen:
        assert seen.getpixel((WIDTH - 1, HEIGHT - 1)) == 65535, "any reader of PNG sees the same"


def test_a_picture_that_ends_before_its_end_is_none() -> None:
    file = depth.encoded(room())
    assert [cut for cut in range(len(file)) if depth.head(file[:cut]) is not None] == []


def test_a_picture_with_a_flipped_bit_is_none() -> None:
    file = depth.encoded(room())
    for at in range(0, len(file), 7):
        broken = bytearray(file)
        broken[at] ^= 4
        assert depth.head(bytes(broken)) is None, at


def test_what_has_other_colours_or_another_form_is_none() -> None:
    grey = Image.fromarray((room() >> 8).astype(np.uint8))
    for file in (png(grey), png(grey.convert("RGB")), jpeg(1), b"", b"\x89PNG\r\n\x1a\n"):
        assert depth.head(file) is None
        assert depth.decoded(file) is None


def test_what_is_whole_by_its_chunks_and_holds_too_few_rows_is_not_decoded() -> None:
    file = depth.encoded(room())
    at = file.index(b"IDAT") - 4
    body = b"IDAT" + zlib.compress(b"\x00" * 40)
    short = file[:at] + (len(body) - 4).to_bytes(4) + body + zlib.crc32(body).to_bytes(4) + file[-12:]
    assert depth.head(short) == (WIDTH, HEIGHT)
    assert depth.decoded(short) is None


def test_a_picture_that_would_fill_the_memory_is_not_opened() -> None:
    body = b"IHDR" + (100_000).to_bytes(4) + (100_000).to_bytes(4) + bytes([16, 0, 0, 0, 0])
    file = depth.encoded(room())
    vast = file[:8] + (13).to_bytes(4) + body + zlib.crc32(body).to_bytes(4) + file[33:]
    assert depth.head(vast) == (100_000, 100_000)
    assert depth.decoded(vast) is None


def test_metres_become_millimetres_and_what_is_out_of_range_is_no_depth() -> None:
    steps = depth.of_metres(
        np.array([[0.0, 0.0004, 0.0006, 1.2344, 9.9999, 10.001, np.inf, np.nan, -1.0]]), farthest_m=10.0
    )
    assert steps.tolist() == [[0, 0, 1, 1234, 10000, 0, 0, 0, 0]]
    assert depth.of_metres(np.array([[65.5, 65.6]]), farthest_m=100.0).tolist() == [[65500, 0]]
    assert depth.in_metres(steps, 0.001)[0, 3] == pytest.approx(1.234)


def test_steps_of_a_camera_become_millimetres() -> None:
    steps = np.array([[0, 1, 3, 40000]], dtype=np.uint16)
    assert depth.rescaled(steps, 0.001) is steps
    assert depth.rescaled(steps, 0.0001).tolist() == [[0, 0, 0, 4000]]
    assert depth.rescaled(steps, 0.002).tolist() == [[0, 2, 6, 0]], "what is too far for 16 bits is no depth"
