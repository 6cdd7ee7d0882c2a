"""What protobuf looks like in bytes, as far as it is quicker, or lighter, to do without the library."""

from __future__ import annotations

from collections.abc import Iterator

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
"""Wire types."""

_FIXED = {FIXED64: 8, FIXED32: 4}  # bytes of a field by its wire type
_LONGEST = 10  # bytes of a number


def varint(number: int) -> bytes:
    """Return a number, 0 or more, as protobuf writes it: seven bits a byte, the lowest first."""
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    out.append(number)
    return bytes(out)


def bytes_of(message: bytes, number: int) -> bytes:
    """Return the bytes of a field of type ``bytes``, by its number; empty where the message has none.

    Raises:
        ValueError: the bytes are no message.
    """
    found = b""
    for field, kind, start, end in fields(message):
        if field == number and kind == BYTES:
            found = message[start:end]
    return found


def number_at(message: bytes | memoryview, start: int) -> int:
    """Return the number that begins at a byte.

    Raises:
        ValueError: none does.
    """
    return _read(message, start)[0]


def fields(message: bytes | memoryview) -> Iterator[tuple[int, int, int, int]]:
    """Iterate over the fields of a message: number, wire type, and from where to where its bytes are.

    Raises:
        ValueError: the bytes are no message.
    """
    position = 0
    while position < len(message):
        tag, position = _read(message, position)
        kind = tag & 7
        if kind == BYTES:
            size, position = _read(message, position)
            end = position + size
        elif kind == VARINT:
            _, end = _read(message, position)
        else:
            end = position + _FIXED.get(kind, len(message))
        if end > len(message):
            raise ValueError(f"a field reaches {end - len(message)} bytes beyond its end")
        yield tag >> 3, kind, position, end
        position = end


def _read(message: bytes | memoryview, position: int) -> tuple[int, int]:
    """Return the number at a place, and the place behind it."""
    found = shift = 0
    for at in range(position, min(position + _LONGEST, len(message))):
        found |= (message[at] & 127) << shift
        shift += 7
        if message[at] < 128:
            return found, at + 1
    raise ValueError(f"no number at byte {position}")
