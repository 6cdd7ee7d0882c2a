"""Reads ROS 2's messages as they are on the wire: CDR, as in OMG's DDS-XTypes 1.3, 7.4.1 (XCDR1)."""

from __future__ import annotations

import struct

_HEAD_BYTES = 4  # of any message: how the rest is written
_ORDERS = {b"\x00\x01": "<", b"\x00\x00": ">"}
_NANOSECONDS = 1_000_000_000


class Cursor:
    """Reads a message from its beginning; numbers lie at multiples of their size, counted behind the head.

    Args:
        data: The message.
        bad: What is raised, with one line, where it does not hold together.
    """

    def __init__(self, data: bytes | memoryview, bad: type[ValueError]) -> None:
        order = _ORDERS.get(bytes(data[:2]))
        if len(data) < _HEAD_BYTES or order is None:
            raise bad(f"a message of {len(data)} bytes that does not begin as XCDR1 does")
        self._order, self._bad = order, bad
        self._data, self._at = memoryview(data)[_HEAD_BYTES:], 0

    def number(self, code: str) -> int:
        """Return the next number, by its code of `struct`."""
        return int(self.numbers(code)[0])

    def numbers(self, code: str, count: int = 1) -> tuple[float, ...]:
        """Return several numbers."""
        size = struct.calcsize(code)
        self._at += -self._at % size
        part = self.take(size * count)
        return struct.unpack(f"{self._order}{count}{code}", part)

    def sequence(self, code: str) -> tuple[float, ...]:
        """Return the numbers of a sequence; an empty one has no gap before its first."""
        count = self.number("I")
        return self.numbers(code, count) if count else ()

    def text(self) -> str:
        """Return the next string."""
        part = bytes(self.take(self.number("I")))
        try:
            return part.rstrip(b"\0").decode()
        except UnicodeDecodeError:
            raise self._bad("a name that is no UTF-8") from None

    def take(self, count: int) -> memoryview:
        """Return the next bytes."""
        part = self._data[self._at : self._at + count]
        if len(part) < count:
            raise self._bad(f"truncated: {count} bytes are told of at byte {self._at}, {len(part)} came")
        self._at += count
        return part

    def header(self) -> tuple[int, str]:
        """Return stamp [ns] and frame."""
        seconds, nanos = self.number("i"), self.number("I")
        return seconds * _NANOSECONDS + nanos, self.text()
