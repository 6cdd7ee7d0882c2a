"""The parser of the stream, byte by byte: no server needed."""

from __future__ import annotations

import logging

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.bus.connection import pack
from station.bus.tap.stream import Stream, encoded_length
from station.errors import BusError

keys = st.sampled_from([b"a", b"b", b"a@", b"unitree", b"\xff\xfe"])
values = st.one_of(
    st.binary(max_size=40), st.sampled_from([b"\r\n", b"\n", b"$3\r\n", b"*1\r\n", b"x" * 99, b"x" * 1000])
)
sets = st.tuples(st.just(b"SET"), keys, values)
stamped = st.builds(lambda key, value, stamp: (b"MSET", key, value, key + b"@", stamp), keys, values, values)
deletions = st.tuples(st.just(b"DEL"), keys)
others = st.sampled_from([(b"PING",), (b"MULTI",), (b"EXEC",), (b"PEXPIREAT", b"a", b"1795230971000")])
commands = st.lists(st.one_of(sets, stamped, deletions, others), max_size=30)


@given(st.lists(st.one_of(values, st.binary(min_size=9, max_size=11)), min_size=1, max_size=120))
def test_length_of_a_command_is_its_length_on_the_wire(command: list[bytes]) -> None:
    assert encoded_length(command) == len(pack(*command))


@pytest.mark.parametrize("size", [0, 9, 10, 99, 100, 999, 1000, 65_536, 1_000_000])
def test_length_is_right_where_the_number_of_digits_changes(size: int) -> None:
    assert encoded_length([b"SET", b"k", b"x" * size]) == len(pack(b"SET", b"k", b"x" * size))


@settings(max_examples=150)
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


def test_command_without_the_whole_value_is_counted_and_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    stream = _stream()
    with caplog.at_level(logging.WARNING):
        assert stream.feed(pack("APPEND", "a", "x") * 3 + pack("HSET", "h", "f", "v")) == []
    assert stream.not_mirrored == 4
    assert [record.getMessage().split(":")[0] for record in caplog.records] == ["not mirrored"] * 2


@pytest.mark.parametrize("data", [b"+PONG\r\n", b"hello\r\n", b":1\r\n", pack("SET", "a"), b"*0\r\n", b"*1\r\n:5\r\n"])
def test_bytes_that_are_no_command_are_an_error(data: bytes) -> None:
    with pytest.raises(BusError, match="replication stream"):
        _stream().feed(data)


def test_request_for_an_acknowledgement_is_noticed() -> None:
    stream = _stream()
    stream.feed(pack("REPLCONF", "GETACK", "*"))
    assert stream.wants_answer


def _stream(offset: int = 0) -> Stream:
    return Stream(db=0, offset=offset, selected_db=0)
