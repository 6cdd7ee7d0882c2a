"""The parser of the stream, byte by byte: no server needed."""

from __future__ import annotations

import logging

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.bus import keys
from station.bus.connection import pack
from station.bus.tap import Write, not_mirrored
from station.bus.tap.base import PROBE, Snapshot
from station.bus.tap.stream import Stream, encoded_length
from station.errors import BusError
from tests.examples import examples

names = st.sampled_from([b"a", b"b", b"a@", b"unitree", b"\xff\xfe"])
values = st.one_of(
    st.binary(max_size=40), st.sampled_from([b"\r\n", b"\n", b"$3\r\n", b"*1\r\n", b"x" * 99, b"x" * 1000])
)
sets = st.tuples(st.just(b"SET"), names, values)
stamped = st.builds(lambda key, value, stamp: (b"MSET", key, value, key + b"@", stamp), names, values, values)
deletions = st.tuples(st.just(b"DEL"), names)
others = st.sampled_from([(b"PING",), (b"MULTI",), (b"EXEC",), (b"PEXPIREAT", b"a", b"1795230971000")])
commands = st.lists(st.one_of(sets, stamped, deletions, others), max_size=30)


@given(st.lists(st.one_of(values, st.binary(min_size=9, max_size=11)), min_size=1, max_size=120))
def test_length_of_a_command_is_its_length_on_the_wire(command: list[bytes]) -> None:
    assert encoded_length(command) == len(pack(*command))


@pytest.mark.parametrize("size", [0, 9, 10, 99, 100, 999, 1000, 65_536, 1_000_000])
def test_length_is_right_where_the_number_of_digits_changes(size: int) -> None:
    assert encoded_length([b"SET", b"k", b"x" * size]) == len(pack(b"SET", b"k", b"x" * size))


@settings(max_examples=examples(150))
@given(commands, st.lists(st.integers(1, 60), min_size=1, max_size=20), st.integers(0, 1 << 50))
def test_pieces_of_any_size_give_the_same_writes_and_the_exact_offset(
    stream_commands: list[tuple[bytes, ...]], sizes: list[int], offset: int
) -> None:
    data = b"".join(pack(*command) for command in stream_commands)
    whole, pieces = _stream(offset), _stream(offset)
    expected = [write[:3] for write in whole.feed(data)]
    seen, at, turn = [], 0, 0
    while at < len(data):
        step = sizes[turn % len(sizes)]
        seen += [write[:3] for write in pieces.feed(data[at : at + step])]
        at, turn = at + step, turn + 1
    assert seen == expected
    assert pieces.offset == whole.offset == offset + len(data)


def test_offset_stands_at_the_last_whole_command() -> None:
    stream, whole, half = _stream(), pack("SET", "a", "1"), pack("SET", "b", "2")[:9]
    assert [write.key for write in stream.feed(whole + half)] == ["a"]
    assert stream.offset == len(whole)


def test_keep_alive_between_commands_is_neither_a_write_nor_counted() -> None:
    stream, command = _stream(), pack("SET", "a", "1")
    seen = stream.feed(b"\n") + stream.feed(b"\n\n" + command) + stream.feed(b"\n" + command)
    assert [write.value for write in seen] == [b"1", b"1"]
    assert stream.offset == 2 * len(command)


def test_newline_that_is_data_stays_data() -> None:
    stream, command = _stream(), pack("SET", "a", "\n\n")
    cut = command.index(b"\n\n")
    seen = stream.feed(command[:cut]) + stream.feed(command[cut:])
    assert [write.value for write in seen] == [b"\n\n"]
    assert stream.offset == len(command)


def test_key_and_stamp_of_one_command_are_one_write() -> None:
    seen = _stream().feed(pack("MSET", "a", "1", "a@", "s1", "b", "2", "b@", "s2", "c", "3"))
    assert [write[:3] for write in seen] == [("a", b"1", b"s1"), ("b", b"2", b"s2"), ("c", b"3", None)]


def test_stamp_before_its_key_is_paired_too() -> None:
    assert [write[:3] for write in _stream().feed(pack("MSET", "a@", "s", "a", "1"))] == [("a", b"1", b"s")]


def test_key_that_is_written_twice_by_one_command_is_two_writes() -> None:
    assert [write.value for write in _stream().feed(pack("MSET", "a", "1", "a", "2"))] == [b"1", b"2"]


def test_lone_stamp_is_a_key_of_its_own() -> None:
    assert [write[:3] for write in _stream().feed(pack("SET", "a@", "s"))] == [("a@", b"s", None)]


def test_stamps_of_two_commands_are_not_mixed() -> None:
    seen = _stream().feed(pack("SET", "a", "1") + pack("SET", "a@", "s"))
    assert [write[:3] for write in seen] == [("a", b"1", None), ("a@", b"s", None)]


@pytest.mark.parametrize(
    "command",
    [
        ("SET", "a", "1"),
        ("set", "a", "1"),
        ("SET", "a", "1", "PXAT", "1795230971000"),
        ("SET", "a", "1", "NX", "KEEPTTL"),
        ("SETEX", "a", "10", "1"),
        ("PSETEX", "a", "10000", "1"),
        ("SETNX", "a", "1"),
        ("GETSET", "a", "1"),
        ("MSETNX", "a", "1"),
    ],
)
def test_every_way_to_set_a_string_is_a_write(command: tuple[str, ...]) -> None:
    assert [write[:3] for write in _stream().feed(pack(*command))] == [("a", b"1", None)]


@pytest.mark.parametrize("command", [("DEL", "a", "a@"), ("UNLINK", "a"), ("GETDEL", "a"), ("del", "a")])
def test_every_way_to_delete_a_key_is_a_write_without_a_value(command: tuple[str, ...]) -> None:
    assert [write[:3] for write in _stream().feed(pack(*command))] == [("a", None, None)]


def test_flush_deletes_every_key_that_was_seen_and_is_still_there() -> None:
    stream = _stream()
    stream.feed(pack("MSET", "a", "1", "a@", "s", "b", "2", "gone", "3") + pack("DEL", "gone"))
    assert {write[:3] for write in stream.feed(pack("FLUSHALL"))} == {("a", None, None), ("b", None, None)}
    assert stream.feed(pack("FLUSHDB")) == []


def test_other_databases_are_left_out() -> None:
    stream = _stream()
    seen = stream.feed(
        b"".join(pack(*c) for c in [("SELECT", 1), ("SET", "a", 1), ("FLUSHDB",), ("SELECT", 0), ("SET", "b", 2)])
    )
    assert [write.key for write in seen] == ["b"]


def test_key_that_is_no_text_is_escaped() -> None:
    assert _stream().feed(pack("SET", b"a\xff", "1"))[0].key == "a\\xff"


def test_command_whose_result_is_unknown_is_said_each_time_and_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    stream = _stream()
    with caplog.at_level(logging.WARNING):
        seen = stream.feed(pack("APPEND", "a", "x") * 3 + pack("HSET", "h", "f", "v"))
    assert [_said(write) for write in seen] == [("APPEND", "a")] * 3 + [("HSET", "h")]
    assert [record.getMessage().split(":")[0] for record in caplog.records] == ["not mirrored"] * 2


PARTIAL: list[tuple[tuple[tuple[str | int, ...], ...], list[tuple[str, bytes | None]]]] = [
    ((("SET", "a", "1"), ("APPEND", "a", "2"), ("append", "a", "3")), [("a", b"1"), ("a", b"12"), ("a", b"123")]),
    ((("SET", "a", "12345"), ("SETRANGE", "a", 1, "xy")), [("a", b"12345"), ("a", b"1xy45")]),
    ((("SET", "a", "1"), ("SETRANGE", "a", 3, "x")), [("a", b"1"), ("a", b"1\0\0x")]),
    ((("SET", "a", "5"), ("INCR", "a"), ("DECRBY", "a", 9)), [("a", b"5"), ("a", b"6"), ("a", b"-3")]),
    ((("SET", "a", b"\x40"), ("SETBIT", "a", 9, 1), ("SETBIT", "a", 1, 0)),
     [("a", b"\x40"), ("a", b"\x40\x40"), ("a", b"\x00\x40")]),
    ((("SET", "a", "1"), ("RENAME", "a", "b")), [("a", b"1"), ("a", None), ("b", b"1")]),
    ((("SET", "a", "1"), ("RENAMENX", "a", "b"), ("APPEND", "b", "2")),
     [("a", b"1"), ("a", None), ("b", b"1"), ("b", b"12")]),
    ((("SET", "a", "1"), ("COPY", "a", "b", "REPLACE")), [("a", b"1"), ("b", b"1")]),
    ((("SELECT", 1), ("SET", "a", "1"), ("COPY", "a", "b", "DB", 0)), [("b", b"1")]),
    ((("SELECT", 1), ("SET", "a", "1"), ("APPEND", "a", "2"), ("MOVE", "a", 0)), [("a", b"12")]),
    ((("SET", "a", "1"), ("MOVE", "a", 1)), [("a", b"1"), ("a", None)]),
    ((("MSET", "a", "1", "a@", "s"), ("COPY", "a@", "b@")), [("a", b"1"), ("b@", b"s")]),
    ((("FLUSHALL",), ("APPEND", "a", "1"), ("INCR", "n")), [("a", b"1"), ("n", b"1")]),
]  # fmt: skip


@pytest.mark.parametrize(("written", "expected"), PARTIAL)
def test_command_that_carries_a_part_is_a_write_of_the_whole_value_where_that_is_known(
    written: tuple[tuple[str | int, ...], ...], expected: list[tuple[str, bytes | None]]
) -> None:
    seen = _stream().feed(b"".join(pack(*command) for command in written))
    assert [write[:2] for write in seen] == expected


UNKNOWN: list[tuple[tuple[tuple[str | int, ...], ...], tuple[str, str]]] = [
    ((("COPY", "a", "b"),), ("COPY", "b")),
    ((("RENAME", "a", "b"),), ("RENAME", "b")),
    ((("SET", "a", "1"), ("BITFIELD", "a", "SET", "u8", 0, 5), ("APPEND", "a", "2")), ("APPEND", "a")),
    ((("SET", "a", "1"), ("BITOP", "NOT", "a", "b"), ("APPEND", "a", "2")), ("APPEND", "a")),
    ((("SET", "a", "x" * 2_000_000), ("COPY", "a", "b")), ("COPY", "b")),
    ((("SET", "a", "1"), ("SETRANGE", "a", 1 << 29, "x")), ("SETRANGE", "a")),
    ((("SET", "a", "1"), ("SWAPDB", 0, 1)), ("SWAPDB", "")),
    ((("SET", "a", "1"), ("SWAPDB", 0, 1), ("APPEND", "a", "2")), ("APPEND", "a")),
    ((("RESTORE", "a", 0, b"\x02\x01\x01x" + bytes(10)),), ("RESTORE", "a")),
]


@pytest.mark.parametrize(("written", "expected"), UNKNOWN)
def test_what_a_key_holds_is_never_guessed(
    written: tuple[tuple[str | int, ...], ...], expected: tuple[str, str]
) -> None:
    seen = _stream().feed(b"".join(pack(*command) for command in written))
    assert _said(seen[-1]) == expected


def test_snapshot_counts_from_its_own_probe_on() -> None:
    stream = _stream()
    stream.snapshot = Snapshot(b"token", {b"a": b"1", b"a@": b"s"}, (b"large",), is_whole=True)
    before = stream.feed(pack("APPEND", "a", "2") + pack("SET", PROBE, "of another tap") + pack("APPEND", "a", "3"))
    assert [_said(write) for write in before] == [("APPEND", "a")] * 2
    after = stream.feed(
        pack("SET", PROBE, "token") + pack("APPEND", "a", "2") + pack("INCR", "new") + pack("APPEND", "large", "x")
    )
    assert [write[:2] for write in after[:2]] == [("a", b"12"), ("new", b"1")]
    assert _said(after[2]) == ("APPEND", "large")
    assert {write[:2] for write in stream.feed(pack("FLUSHALL"))} == {("a", None), ("large", None), ("new", None)}


def test_a_probe_has_come_by_whatever_other_taps_write_before_and_after_it() -> None:
    stream = _stream()
    stream.awaited = b"token"
    stream.feed(pack("SET", PROBE, "of another tap"))
    assert stream.awaited == b"token"
    stream.feed(pack("SET", PROBE, "token") + pack("SET", PROBE, "of a third tap") + pack("DEL", PROBE))
    assert stream.awaited is None


def test_memory_for_values_is_bounded() -> None:
    stream = _stream()
    for number in range(80):
        stream.feed(pack("SET", f"key{number}", b"x" * (1 << 20)))
    assert stream._values._size <= 64 << 20
    assert _said(stream.feed(pack("COPY", "key0", "b"))[-1]) == ("COPY", "b")


@pytest.mark.parametrize("data", [b"+PONG\r\n", b"hello\r\n", b":1\r\n", pack("SET", "a"), b"*0\r\n", b"*1\r\n:5\r\n"])
def test_bytes_that_are_no_command_are_an_error(data: bytes) -> None:
    with pytest.raises(BusError, match="replication stream"):
        _stream().feed(data)


def test_request_for_an_acknowledgement_is_noticed() -> None:
    stream = _stream()
    stream.feed(pack("REPLCONF", "GETACK", "*"))
    assert stream.wants_answer


def _said(write: Write) -> tuple[str, str] | None:
    """What the tap says of a write that it cannot show; None for one that it shows."""
    said = not_mirrored.decode(write.value or b"") if write.key == keys.NOT_MIRRORED else None
    return None if said is None else (said.command, said.key)


def _stream(offset: int = 0) -> Stream:
    return Stream(db=0, offset=offset, selected_db=0)
