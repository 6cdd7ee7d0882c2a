"""Lines of gloves: what is one, what is none, and that it does not matter how the bytes are cut."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.glove.lines import LONGEST, Line, LineReader, numbers, opengloves

LUCIDGLOVE = b"A0B4095C77D812E3040F2047G2047P0JK(AB)2047(BB)2047(CB)0(DB)1(EB)2"


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (b"812 640 3 4 5\r", (812, 640, 3, 4, 5)),
        (b" 812,640,3,4,5", (812, 640, 3, 4, 5)),
        (b"1 , 2,\t3\t4  5,", (1, 2, 3, 4, 5)),
        (b"0.5 -.25 +3. 1e3 -2E-1", (0.5, -0.25, 3.0, 1000.0, -0.2)),
        (b"7", (7,)),
    ],
)
def test_numbers_have_spaces_or_commas_between(line: bytes, found: Line) -> None:
    assert numbers(line) == found


@pytest.mark.parametrize(
    "line",
    [
        b"", b",", b"1,,2", b"1 2 x", b"nan 1", b"inf", b"-inf 1", b"1e999", b"1_000", b"0x10", b"1;2", b"1 2 3\x00",
        b"- 1", b"1e", b"9" * 400, b"\xff\xfe", "١ ٢".encode(), b"2e9",
    ],
)  # fmt: skip
def test_what_is_no_numbers_is_none(line: bytes) -> None:
    assert numbers(line) is None


def test_the_letters_of_a_lucidglove_are_its_fingers_and_the_rest_is_passed_over() -> None:
    assert opengloves(LUCIDGLOVE) == (0, 4095, 77, 812, 3040)
    assert opengloves(b"E5D4C3B2A1\r") == (1, 2, 3, 4, 5)


@pytest.mark.parametrize(
    "line",
    [
        b"", b"A1B2C3D4", b"A1B2C3D4E", b"A1B2C3D4E4096", b"A1B2C3D4E00005", b"A1A1B2C3D4E5", b"A1B2C3D4E-5",
        b"A1 B2 C3 D4 E5", b"a1b2c3d4e5", b"A1B2C3D4E5(AB", b"1A1B2C3D4E5", b"A1.5B2C3D4E5", b"ABCDE",
        b"(A)1(B)2(C)3(D)4(E)5",
    ],
)  # fmt: skip
def test_what_is_no_line_of_an_openglove_is_none(line: bytes) -> None:
    assert opengloves(line) is None


PIECES = st.one_of(
    st.lists(st.integers(-9999, 9999), min_size=1, max_size=7).map(lambda row: " ".join(map(str, row)).encode()),
    st.binary(max_size=20), st.just(b"x" * (LONGEST + 1)), st.just(b"1 " * LONGEST), st.just(b" " * (LONGEST + 1)),
)  # fmt: skip


@given(
    pieces=st.lists(st.tuples(PIECES, st.sampled_from([b"\n", b"\r\n", b"\n\n", b""])), max_size=12),
    cuts=st.lists(st.integers(0, 3000), max_size=30),
)
def test_any_cut_of_the_bytes_gives_the_same_lines(pieces: list[tuple[bytes, bytes]], cuts: list[int]) -> None:
    data = b"".join(piece + end for piece, end in pieces)
    whole, cut = LineReader("numbers", 5), LineReader("numbers", 5)
    expected = whole.feed(data)
    found, at = [], 0
    for end in [*sorted(cuts), len(data)]:
        found += cut.feed(data[at:end])
        at = max(at, end)
    assert found == expected
    assert (cut.received, cut.bad, cut.last_bad) == (whole.received, whole.bad, whole.last_bad)
    assert all(len(line) == 5 and all(map(math.isfinite, line)) for line in found)


@given(rows=st.lists(st.lists(st.integers(0, 4095), min_size=5, max_size=5), max_size=8), size=st.integers(1, 60))
def test_what_a_glove_writes_is_read_whatever_its_protocol(rows: list[list[int]], size: int) -> None:
    written = {
        "numbers": [",".join(map(str, row)) for row in rows],
        "opengloves": ["".join(f"{key}{count}" for key, count in zip("ABCDE", row, strict=True)) for row in rows],
    }
    for protocol, lines in written.items():
        reader, data = LineReader(protocol, 5), "".join(f"{line}\r\n" for line in ["", *lines]).encode()
        found = [line for at in range(0, len(data), size) for line in reader.feed(data[at : at + size])]
        assert found == [tuple(map(float, row)) for row in rows]
        assert reader.bad == 0


def test_the_line_that_was_under_way_when_the_port_was_opened_is_passed_over() -> None:
    reader = LineReader("numbers", 2)
    assert reader.feed(b"12 34\n56 78\n") == [(56.0, 78.0)]
    assert reader.bad == 0


def test_a_bad_line_is_counted_and_told_safe_to_print_and_short() -> None:
    reader = LineReader("numbers", 2)
    assert reader.feed(b"\n1 2 3\n\x1b[2Jhej \xff\n4 5\n\n\r\n") == [(4.0, 5.0)]
    assert (reader.bad, reader.last_bad) == (2, "\\x1b[2Jhej \\xff")
    reader.feed(b"\x1b" * 500 + b"\n")
    assert len(reader.last_bad) == 60
    assert reader.last_bad.isprintable()


def test_a_line_without_an_end_is_dropped_and_does_not_grow() -> None:
    reader = LineReader("numbers", 1)
    reader.feed(b"\n")
    for _ in range(1000):
        assert reader.feed(b"1" * 100) == []
    assert len(reader._waiting) <= LONGEST
    assert reader.bad == 1
    assert reader.feed(b"1\n2\n") == [(2.0,)], "what is left of it is no line"


def test_a_message_says_what_was_expected() -> None:
    assert LineReader("numbers", 5).expected == "5 numbers with spaces or commas between"
    assert LineReader("numbers", None).expected == "numbers with spaces or commas between"
    assert LineReader("opengloves", 5).expected == "the letters A to E, each with 0 to 4095 behind it"
