"""The string in what `DUMP` returns and `RESTORE` takes: the server's own format of a value.

A type (0 is a string), a length or one of four encodings, the bytes, two bytes of version and a checksum of eight,
which the server verified before it obeyed.
"""

from __future__ import annotations

from station.bus.server_options import LARGEST_VALUE

_STRING = 0
_FOOTER_SIZE = 10
_INTEGERS = {0: 1, 1: 2, 2: 4}  # bytes by encoding
_COMPRESSED = 3
_IS_ENCODED = 3
_LONGEST_LITERAL = 32  # a control byte of LZF below this is followed by so many bytes, and one
_LONG_REFERENCE = 7


def string_in(payload: bytes) -> bytes | None:
    """Return the string that a payload of `RESTORE` holds; None for a value of another type, or bytes that are none."""
    body = payload[:-_FOOTER_SIZE]
    if body[:1] != bytes([_STRING]):
        return None
    try:
        value, end = _string(body, 1)
    except IndexError:
        return None
    return value if end == len(body) else None


def _string(data: bytes, at: int) -> tuple[bytes, int]:
    """Return the string at a place, and where it ends."""
    size, at, is_encoded = _length(data, at)
    if not is_encoded:
        return _cut(data, at, size)
    if size in _INTEGERS:
        number, at = _cut(data, at, _INTEGERS[size])
        return b"%d" % int.from_bytes(number, "little", signed=True), at
    if size != _COMPRESSED:
        raise IndexError(f"no such encoding: {size}")
    packed_size, at, _ = _length(data, at)
    size, at, _ = _length(data, at)
    packed, at = _cut(data, at, packed_size)
    return _decompressed(packed, size), at


def _length(data: bytes, at: int) -> tuple[int, int, bool]:
    """Return a length (or the number of an encoding), where it ends, and whether it is an encoding."""
    first = data[at]
    kind, low = first >> 6, first & 0x3F
    if kind == _IS_ENCODED:
        return low, at + 1, True
    if kind == 0:
        return low, at + 1, False
    if kind == 1:
        return low << 8 | data[at + 1], at + 2, False
    number, end = _cut(data, at + 1, 8 if low == 1 else 4)
    return int.from_bytes(number, "big"), end, False


def _cut(data: bytes, at: int, size: int) -> tuple[bytes, int]:
    if at + size > len(data):
        raise IndexError("it ends too early")
    return data[at : at + size], at + size


def _decompressed(packed: bytes, size: int) -> bytes:
    """Return what LZF made of bytes: literals, and references to what came before."""
    if size > LARGEST_VALUE:
        raise IndexError(f"it claims {size} bytes")
    found, at = bytearray(), 0
    while at < len(packed) and len(found) < size:
        control, at = packed[at], at + 1
        if control < _LONGEST_LITERAL:
            literal, at = _cut(packed, at, control + 1)
            found += literal
            continue
        length = control >> 5
        if length == _LONG_REFERENCE:
            length, at = length + packed[at], at + 1
        start, at = len(found) - ((control & 0x1F) << 8) - packed[at] - 1, at + 1
        if start < 0:
            raise IndexError("it refers to what is before its beginning")
        for place in range(start, start + length + 2):  # may reach into what it writes
            found.append(found[place])
    if len(found) != size:
        raise IndexError(f"{len(found)} bytes where it claims {size}")
    return bytes(found)
