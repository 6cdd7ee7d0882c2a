"""What a terminal shows of what was written to it: what stays, and what was drawn over."""

from __future__ import annotations

import re
from typing import NamedTuple

_PARTS = re.compile(r"\x1b\[([0-9;?]*)([A-Za-z])|([\r\n])|([^\x1b\r\n]+)|\x1b")


class Screen(NamedTuple):
    """Lines of a terminal.

    Attributes:
        stays: What stands there at the end, however far up.
        drawn: What was erased, in the order in which it had been written.
    """

    stays: list[str]
    drawn: list[str]


def screen(written: str) -> Screen:
    """Return what a terminal shows of a text with the sequences that move up and erase a line; others do nothing."""
    rows, row, column = [""], 0, 0
    drawn: list[str] = []
    erased: list[str] = []  # from below to above
    for number, letter, control, text in _PARTS.findall(written):
        if text:
            drawn += reversed(erased)
            erased = []
            rows[row] = f"{rows[row][:column]:{column}}{text}{rows[row][column + len(text) :]}"
            column += len(text)
        elif control == "\r":
            column = 0
        elif control == "\n":
            row, column = row + 1, 0
            rows += [""] * (row == len(rows))
        elif letter == "A":
            row = max(0, row - int(number or 1))
        elif letter == "K":
            erased += [rows[row]] * bool(rows[row])
            rows[row] = ""
    return Screen([line.rstrip() for line in rows], [line.rstrip() for line in drawn])
