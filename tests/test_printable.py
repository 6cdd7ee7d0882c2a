"""Text of others is shown and never obeyed."""

from __future__ import annotations

import pytest

from station.printable import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("walk, then wave: größer als 2 µm", "walk, then wave: größer als 2 µm"),
        ("g1\x1b[2J\x1b[1;1H", r"g1\x1b[2J\x1b[1;1H"),
        ("two\nlines\r", r"two\x0alines\x0d"),
        ("abc\u202edef", r"abc\u202edef"),
        ("\udcff", r"\xff"),
        ("\U000e0001", r"\U000e0001"),
    ],
)
def test_what_would_steer_a_terminal_is_shown_as_what_it_is(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_a_long_text_is_cut() -> None:
    assert printable("x" * 1000) == "x" * 500 + "…"
