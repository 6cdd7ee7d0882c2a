"""What is a whole JPEG file, and what is made of one that lacks its tables."""

from __future__ import annotations

import io

import pytest
from PIL import Image

from station import jpeg
from tests.adapters.cameras import pictures


def without_tables(file: bytes) -> bytes:
    """Return a file without its Huffman tables, as many cameras give them."""
    at, kept = 2, file[:2]
    while file[at + 1] != 0xDA:
        end = at + 2 + int.from_bytes(file[at + 2 : at + 4])
        kept += b"" if file[at + 1] == 0xC4 else file[at:end]
        at = end
    return kept + file[at:]


def test_the_head_tells_size_and_tables() -> None:
    known = jpeg.head(pictures.jpeg(7, 176, 144))
    assert known is not None
    assert (known.width, known.height, known.has_tables) == (176, 144, True)


def test_a_progressive_file_is_known_too() -> None:
    file = io.BytesIO()
    Image.new("RGB", (40, 30)).save(file, "JPEG", progressive=True)
    known = jpeg.head(file.getvalue())
    assert known is not None
    assert (known.width, known.height) == (40, 30)


def test_padding_after_the_end_does_no_harm() -> None:
    assert jpeg.head(pictures.jpeg(1) + bytes(500)) is not None


@pytest.mark.parametrize(
    "data",
    [b"", b"\xff", b"\xff\xd8", b"GIF89a", bytes(100), pictures.jpeg(1)[:-40], pictures.jpeg(1)[:200],
     pictures.jpeg(1)[4:], b"\xff\xd8" + b"\xff\xda\x00\x02" + b"\xff\xd9", b"\xff\xd8" + b"\xff" * 50],
    ids=["empty", "a byte", "start", "another", "zeros", "no end", "no scan", "no start", "no size", "filling"],
)  # fmt: skip
def test_what_is_no_whole_file_is_refused(data: bytes) -> None:
    assert jpeg.head(data) is None


def test_a_file_with_tables_stays_as_it_is() -> None:
    file = pictures.jpeg(3)
    known = jpeg.head(file)
    assert known is not None
    assert jpeg.readable(file, known) is file


def test_a_file_without_tables_gets_the_standard_ones_and_shows_the_same_picture() -> None:
    file = pictures.jpeg(21930)
    bare = without_tables(file)
    known = jpeg.head(bare)
    assert known is not None
    assert not known.has_tables
    mended = jpeg.readable(bare, known)
    assert jpeg.TABLES in mended
    assert (pictures.decoded(mended) == pictures.decoded(file)).all()
