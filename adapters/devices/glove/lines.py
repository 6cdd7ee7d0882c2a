"""Lines of numbers as gloves write them, found in bytes that come in any cuts.

``numbers``: integers or decimals with spaces, tabs or commas between, as microcontrollers print them. LeRobot's
Homunculus glove writes integers with spaces (huggingface/lerobot, ``teleoperators/homunculus/homunculus_glove.py``).

``opengloves``: the alpha encoding, ``A812B3040C77D0E4095F2047G2047P0JK``: a letter per finger from the thumb (A) to the
little finger (E), each with 0 to 4095 behind it. What else a line may hold is checked for its form and ignored: the
stick F and G, the trigger P, the buttons H to O, and keys in brackets, such as how far a finger is spread: ``(AB)2047``
(LucidVR/lucidgloves, ``firmware/lucidgloves-firmware/Encoding.ino``).

Neither has a checksum: a number that lost a digit on its way is a number.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Literal

from station.printable import printable

Protocol = Literal["numbers", "opengloves"]
Line = tuple[float, ...]

LONGEST = 1024
"""Of a line, without its end [bytes]."""

_SHOWN = 60  # characters of a bad line
_LARGEST = 1e9
_MOST_COUNTS = 4095
_BETWEEN = re.compile(rb"\s*,\s*|\s+")
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?")
_KEY = re.compile(rb"(\([A-Z]{1,8}\)|[A-Z])(\d*)")
_FINGER_KEYS = (b"A", b"B", b"C", b"D", b"E")


def numbers(line: bytes) -> Line | None:
    """Return the numbers of a line with spaces or commas between; None when it is none."""
    words = _BETWEEN.split(line.strip().removesuffix(b",").rstrip())
    if not all(_NUMBER.fullmatch(word) for word in words):
        return None
    found = tuple(map(float, words))
    return found if all(abs(number) <= _LARGEST for number in found) else None


def opengloves(line: bytes) -> Line | None:
    """Return the five fingers of a line in the alpha encoding, thumb first; None when it is none."""
    line = line.strip()
    found: dict[bytes, float] = {}
    at = 0
    while at < len(line):
        match = _KEY.match(line, at)
        if match is None:
            return None
        at, key, digits = match.end(), match[1], match[2]
        if key not in _FINGER_KEYS:
            continue
        if key in found or not 1 <= len(digits) <= 4 or int(digits) > _MOST_COUNTS:
            return None
        found[key] = float(digits)
    return tuple(found[key] for key in _FINGER_KEYS) if len(found) == len(_FINGER_KEYS) else None


_PARSE: dict[Protocol, Callable[[bytes], Line | None]] = {"numbers": numbers, "opengloves": opengloves}


class LineReader:
    """Finds good lines; the first, of which the beginning may be missing, and empty ones are passed over.

    Args:
        protocol: How the glove writes.
        count: How many numbers a line has; None for any.

    Attributes:
        received: Bytes so far.
        bad: Lines that were dropped so far: too long, no numbers, or another count of them.
        last_bad: The last one of them, made safe to print and cut short; "" for none.
    """

    def __init__(self, protocol: Protocol, count: int | None) -> None:
        self.received = self.bad = 0
        self.last_bad = ""
        self._protocol, self._count, self._parse = protocol, count, _PARSE[protocol]
        self._waiting = b""
        self._is_dropping = True  # until the end of the line that was under way when the port was opened

    @property
    def expected(self) -> str:
        """What a good line is, for a message."""
        if self._protocol == "opengloves":
            return f"the letters A to E, each with 0 to {_MOST_COUNTS} behind it"
        return f"{'numbers' if self._count is None else f'{self._count} numbers'} with spaces or commas between"

    def feed(self, data: bytes) -> list[Line]:
        """Return the good lines that are complete by now."""
        self.received += len(data)
        *ended, rest = data.split(b"\n")
        found = []
        for end in ended:
            line, is_dropping = self._waiting + end, self._is_dropping
            self._waiting, self._is_dropping = b"", False
            if not is_dropping and (good := self._read(line)) is not None:
                found.append(good)
        self._waiting = b"" if self._is_dropping else self._waiting + rest
        if len(self._waiting) > LONGEST:
            self._drop(self._waiting)
            self._waiting, self._is_dropping = b"", True
        return found

    def _read(self, line: bytes) -> Line | None:
        if not line.strip() and len(line) <= LONGEST:
            return None
        good = self._parse(line) if len(line) <= LONGEST else None
        if good is None or self._count not in (None, len(good)):
            self._drop(line)
            return None
        return good

    def _drop(self, line: bytes) -> None:
        self.bad += 1
        text = printable(line.strip()[: _SHOWN + 1].decode("ascii", "surrogateescape"))
        self.last_bad = text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"
