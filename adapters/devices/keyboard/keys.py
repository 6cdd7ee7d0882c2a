"""What a terminal sends for a key, and what we call it."""

from __future__ import annotations

import re

SEQUENCES = {
    "A": "up", "B": "down", "C": "right", "D": "left", "H": "home", "F": "end",
    "P": "f1", "Q": "f2", "R": "f3", "S": "f4",
    "1~": "home", "2~": "insert", "3~": "delete", "4~": "end", "5~": "page_up", "6~": "page_down",
    "15~": "f5", "17~": "f6", "18~": "f7", "19~": "f8", "20~": "f9", "21~": "f10", "23~": "f11", "24~": "f12",
}  # fmt: skip
"""What follows ``ESC [`` or ``ESC O``."""

SIGNS = {
    " ": "space", "\n": "enter", "\r": "enter", "\t": "tab", "\x7f": "backspace", "\b": "backspace",
    "-": "minus", "=": "equals", "+": "plus", "_": "underscore", ",": "comma", ".": "period", "/": "slash",
    ";": "semicolon", "'": "quote", "[": "left_bracket", "]": "right_bracket", "\\": "backslash", "`": "backquote",
    "<": "less", ">": "greater", "?": "question", "!": "exclamation", "*": "asterisk", ":": "colon",
}  # fmt: skip

ESCAPE = "escape"
NAMES = frozenset(
    (*SEQUENCES.values(), *SIGNS.values(), ESCAPE, *"abcdefghijklmnopqrstuvwxyz0123456789", "shift", "alt")
)

_SEQUENCE = re.compile(rb"\x1b(?:\[|O)([0-9;]*[A-Za-z~])")
_UNFINISHED = re.compile(rb"\x1b(?:(?:\[|O)[0-9;]*)?$")
_ESC = 0x1B


def parse(data: bytes, *, is_all: bool) -> tuple[list[str], bytes]:
    """Return the names of the keys in what a terminal sent, in order, and the bytes that wait for more.

    A capital letter is its key and ``shift``; ESC before a key is ``alt``.

    Args:
        data: What was sent.
        is_all: Whether no more follows: then an ESC at the end is the key of that name.
    """
    found: list[str] = []
    while data:
        if _UNFINISHED.match(data) and not is_all:
            return found, data
        sequence = _SEQUENCE.match(data)
        if sequence is not None:
            # With a modifier it is "1;5A"; the key is the same one.
            ending = sequence[1].decode()
            name = SEQUENCES.get(ending) or SEQUENCES.get(ending[-1] if ";" in ending else "", "")
            found += [name] if name else []
            data = data[sequence.end() :]
        elif data[0] == _ESC:
            found.append("alt" if len(data) > 1 else ESCAPE)
            data = data[1:]
        else:
            found += _plain(chr(data[0]))
            data = data[1:]
    return found, b""


def send(name: str) -> bytes:
    """Return what a terminal sends for a key of a name in `NAMES`."""
    if len(name) == 1:
        return name.encode()
    if name == ESCAPE:
        return b"\x1b"
    for sign, known in SIGNS.items():
        if known == name:
            return sign.encode()
    ending = next(ending for ending, known in SEQUENCES.items() if known == name)
    return (b"\x1bO" if ending in "PQRS" else b"\x1b[") + ending.encode()


def _plain(char: str) -> list[str]:
    if char in SIGNS:
        return [SIGNS[char]]
    if not (char.isascii() and char.isalnum()):
        return []  # control characters, and bytes of letters that are on few keyboards
    return ["shift", char.lower()] if char.isupper() else [char]
