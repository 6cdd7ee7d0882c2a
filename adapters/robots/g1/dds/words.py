"""What the motion switcher's requests and answers say: a header, and JSON.

As bytes: an object of `types.Request` or of `types.Response` takes 0.15 ms, twice a second, and a control period waits.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from station.bus import codec

_REQUEST = struct.Struct("<4sqqqi?3xI3sxI")
_ANSWER = struct.Struct("<4sqqiI")
_CDR = b"\0\1\0\0"  # of version 1, little endian
_NOTHING = b"{}\0"


class Answer(NamedTuple):
    """An answer.

    Attributes:
        number: Of the request.
        code: 0 where it was done.
        text: What it says, in JSON.
    """

    number: int
    code: int
    text: str


def request(number: int, api: int) -> bytes:
    """Return a request without parameters as it is on the wire."""
    return _REQUEST.pack(_CDR, number, api, 0, 0, False, len(_NOTHING), _NOTHING, 0)


def answer_of(data: bytes) -> Answer | None:
    """Return what an answer on the wire says; None for bytes that are none."""
    if len(data) < _ANSWER.size or data[:2] != _CDR[:2]:
        return None
    _, number, _, code, length = _ANSWER.unpack_from(data)
    text = data[_ANSWER.size : _ANSWER.size + length]
    return Answer(number, code, text.rstrip(b"\0").decode(errors="replace")) if len(text) == length else None


def name_of(text: str) -> str | None:
    """Return the controller that a text names: ``ai``, "" for none; None where it names none in words we know."""
    found = codec.parse_facts(text.encode(errors="replace")).get("name")
    return found if isinstance(found, str) else None
