"""What the head of a JPEG file tells: whether the file is whole, its size, and whether others can read it."""

from __future__ import annotations

from typing import NamedTuple

_START, _END = b"\xff\xd8", b"\xff\xd9"
_SCAN, _HUFFMAN = 0xDA, 0xC4
_FRAMES = frozenset(range(0xC0, 0xD0)) - {_HUFFMAN, 0xC8, 0xCC}  # the other three are tables
_BARE = frozenset(range(0xD0, 0xD8)) | {0x01}  # markers without a length

# The tables of ITU-T T.81, annex K.3: how many codes there are of each length, then the values in order. A camera's
# stream may leave them out, since every decoder of motion JPEG knows them; one of single files need not.
_LUMA_DC = (bytes([0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0]), bytes(range(12)))
_CHROMA_DC = (bytes([0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0]), bytes(range(12)))
_LUMA_AC = (
    bytes([0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7D]),
    bytes.fromhex(
        "01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738"
        "393a434445464748494a535455565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5"
        "a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa"
    ),
)
_CHROMA_AC = (
    bytes([0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77]),
    bytes.fromhex(
        "000102031104052131061241510761711322328108144291a1b1c109233352f0156272d10a162434e125f11718191a262728292a353637"
        "38393a434445464748494a535455565758595a636465666768696a737475767778797a82838485868788898a92939495969798999aa2a3"
        "a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae2e3e4e5e6e7e8e9eaf2f3f4f5f6f7f8f9fa"
    ),
)


class Head(NamedTuple):
    """What stands before the first scan.

    Attributes:
        width, height: Size of the picture [px].
        scan: Where the first scan begins [byte].
        has_tables: Whether the file brings the Huffman tables that it needs.
    """

    width: int
    height: int
    scan: int
    has_tables: bool


def head(data: bytes) -> Head | None:
    """Return what the head of a whole JPEG file tells, or None for anything else.

    Whole is what begins as a JPEG file does, has a size and a scan, and an end after it; padding may follow that.
    """
    if not data.startswith(_START):
        return None
    at, size, has_tables = 2, (0, 0), False
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _BARE or marker == 0xFF:  # 0xFF fills up
            at += 1 if marker == 0xFF else 2
            continue
        if marker == _SCAN:
            is_whole = 0 not in size and data.rfind(_END, at) > 0
            return Head(size[0], size[1], at, has_tables) if is_whole else None
        if marker in _FRAMES and at + 9 <= len(data):
            size = (int.from_bytes(data[at + 7 : at + 9]), int.from_bytes(data[at + 5 : at + 7]))
        has_tables = has_tables or marker == _HUFFMAN
        at += 2 + int.from_bytes(data[at + 2 : at + 4])
    return None


def readable(data: bytes, known: Head) -> bytes:
    """Return a file that any decoder reads: the same bytes, or with the standard Huffman tables where it has none."""
    return data if known.has_tables else data[: known.scan] + TABLES + data[known.scan :]


def _tables() -> bytes:
    kinds = ((0x00, _LUMA_DC), (0x10, _LUMA_AC), (0x01, _CHROMA_DC), (0x11, _CHROMA_AC))
    body = b"".join(bytes([kind]) + counts + values for kind, (counts, values) in kinds)
    return bytes([0xFF, _HUFFMAN]) + (len(body) + 2).to_bytes(2) + body


TABLES = _tables()
"""The segment with the standard Huffman tables."""
