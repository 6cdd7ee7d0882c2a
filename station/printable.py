"""Text of others made safe to print: names and reasons from the bus or a file must not steer a terminal."""

from __future__ import annotations

_LONGEST = 500  # characters; the exact bytes stand in the episode


def printable(text: str, longest: int = _LONGEST) -> str:
    r"""Return text on one line that shows control characters, bidirectional marks and half characters as ``\x1b``.

    A terminal would take them for orders: to erase what stands above, to recolour, to type.
    """
    if len(text) > longest:
        text = text[:longest] + "…"
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else _escaped(char) for char in text)


def _escaped(char: str) -> str:
    code = ord(char)
    if 0xDC80 <= code <= 0xDCFF:  # a byte that is no UTF-8
        return f"\\x{code - 0xDC00:02x}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
