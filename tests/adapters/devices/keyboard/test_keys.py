"""What terminals send for keys."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.keyboard import keys

PRESSABLE = sorted(keys.NAMES - {"shift", "alt"})


@pytest.mark.parametrize("name", PRESSABLE)
def test_each_key_is_read_as_what_was_pressed(name: str) -> None:
    assert keys.parse(keys.send(name), is_all=True) == ([name], b"")


@given(names=st.lists(st.sampled_from([name for name in PRESSABLE if name != "escape"]), max_size=8))
def test_keys_in_a_row_are_read_in_order(names: list[str]) -> None:
    assert keys.parse(b"".join(map(keys.send, names)), is_all=True) == (names, b"")


@given(names=st.lists(st.sampled_from([name for name in PRESSABLE if name != "escape"]), max_size=8), data=st.data())
def test_a_sequence_that_comes_in_pieces_is_one_key(names: list[str], data: st.DataObject) -> None:
    sent = b"".join(map(keys.send, names))
    cut = data.draw(st.integers(0, len(sent)))
    first, waiting = keys.parse(sent[:cut], is_all=False)
    rest, _ = keys.parse(waiting + sent[cut:], is_all=True)
    assert first + rest == names


@given(data=st.binary(max_size=40))
def test_whatever_comes_is_keys_or_nothing(data: bytes) -> None:
    found, waiting = keys.parse(data, is_all=True)
    assert set(found) <= keys.NAMES
    assert waiting == b""


@pytest.mark.parametrize(
    ("data", "names"),
    [
        (b"W", ["shift", "w"]),
        (b"\x1bw", ["alt", "w"]),
        (b"\x1b[1;5A", ["up"]),  # with Ctrl
        (b"\x1bOA", ["up"]),  # an arrow in application mode
        (b"\x1b[3;2~", []),
        (b"\x1b[200~", []),  # a paste begins
        ("é".encode(), []),
        (b"\x01\x00", []),
    ],
)
def test_modifiers_and_what_is_no_key(data: bytes, names: list[str]) -> None:
    assert keys.parse(data, is_all=True) == (names, b"")


def test_an_escape_waits_for_what_may_follow() -> None:
    assert keys.parse(b"a\x1b", is_all=False) == (["a"], b"\x1b")
    assert keys.parse(b"\x1b[1", is_all=False) == ([], b"\x1b[1")
    assert keys.parse(b"\x1b", is_all=True) == (["escape"], b"")
