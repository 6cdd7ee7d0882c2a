"""Writes by other commands than SET and MSET, on a real server: what a robot's watch reads is what the tap shows."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.tap import not_mirrored
from station.bus.tap.dumped import string_in
from station.bus.tap.replication import ReplicationTap
from station.bus.watch import Watch
from tests.bus.tap.conftest import Collect
from tests.waiting import wait_until

KEY = twist_keys.action_body()
VECTOR = b"[%b]" % b",".join(b"0.125" for _ in range(35))

Request = tuple[str | bytes | int, ...]
LAST = b"[0.5,0.25]"
WAYS: dict[str, list[Request]] = {
    "SET": [("SET", KEY, LAST)],
    "SET with GET": [("SET", KEY, LAST, "GET")],
    "GETSET": [("GETSET", KEY, LAST)],
    "GETEX": [("SET", KEY, LAST), ("GETEX", KEY, "PX", 100_000)],
    "APPEND": [("SET", KEY, LAST[:5]), ("APPEND", KEY, LAST[5:])],
    "APPEND to what was there before": [("SETRANGE", KEY, 0, LAST[:5]), ("APPEND", "rest", LAST[5:])],
    "SETRANGE": [("SET", KEY, b"[9.5,0.25]"), ("SETRANGE", KEY, 1, "0")],
    "COPY": [("SET", "x", LAST), ("COPY", "x", KEY, "REPLACE")],
    "COPY of what was there before": [("COPY", "old", KEY, "REPLACE")],
    "COPY from another database": [
        ("SELECT", 1), ("SET", "x", LAST), ("COPY", "x", KEY, "DB", 0, "REPLACE"), ("SELECT", 0)
    ],
    "RENAME": [("SET", "x", LAST), ("RENAME", "x", KEY)],
    "RENAME of what was there before": [("RENAME", "old", KEY)],
    "MOVE": [("DEL", KEY), ("SELECT", 1), ("SET", KEY, LAST), ("MOVE", KEY, 0), ("SELECT", 0)],
    "EVAL": [("EVAL", "redis.call('SET', KEYS[1], ARGV[1]); redis.call('APPEND', KEYS[1], ARGV[2])", 1, KEY, LAST[:3],
              LAST[3:])],
    "MULTI": [("MULTI",), ("SET", KEY, LAST[:1]), ("APPEND", KEY, LAST[1:]), ("EXEC",)],
}  # fmt: skip


@pytest.fixture
def tap(bus_server: BusAddress, writer: Connection) -> Iterator[ReplicationTap]:
    writer.call("MSET", KEY, b"x" * len(LAST), "old", LAST, "rest", "")
    tap = ReplicationTap(bus_server)
    yield tap
    tap.close()


@pytest.mark.parametrize("way", [*WAYS, "RESTORE", "RESTORE of a compressed value"])
def test_what_a_robot_reads_is_what_the_tap_shows(
    bus_server: BusAddress, tap: ReplicationTap, writer: Connection, collect: Collect, way: str
) -> None:
    expected = VECTOR if way == "RESTORE of a compressed value" else LAST
    watch = Watch(bus_server, [KEY])
    try:
        if way == "APPEND to what was there before":
            writer.pipeline([("SET", KEY, ""), ("SETRANGE", KEY, 0, LAST[:5]), ("APPEND", KEY, LAST[5:])])
        elif way in WAYS:
            writer.pipeline(WAYS[way])
        else:
            writer.call("SET", "x", expected)
            writer.call("RESTORE", KEY, 0, writer.call("DUMP", "x"), "REPLACE")
        wait_until(lambda: (sample := watch.latest(KEY)) is not None and sample.value == expected)
    finally:
        watch.close()
    seen = collect(tap)
    assert [write.value for write in seen if write.key == KEY][-1] == expected == writer.call("GET", KEY)
    assert [write for write in seen if write.key == keys.NOT_MIRRORED] == []


def test_deletion_by_getdel_and_by_flushall_is_told_of_keys_from_before_the_tap_too(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    writer.call("GETDEL", "rest")
    writer.call("FLUSHALL")
    assert {write[:2] for write in collect(tap)} == {("rest", None), ("old", None), (KEY, None)}


def test_what_the_tap_cannot_know_is_said_with_command_and_key(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    writer.pipeline([("BITFIELD", KEY, "SET", "u8", 0, 5), ("HSET", "other", "f", "v")])
    said = [not_mirrored.decode(write.value or b"") for write in collect(tap) if write.key == keys.NOT_MIRRORED]
    assert [(one.command, one.key) for one in said if one is not None] == [("BITFIELD", KEY), ("HSET", "other")]


def test_user_without_transactions_gets_the_tap_all_the_same(
    bus_server: BusAddress, writer: Connection, collect: Collect
) -> None:
    writer.call("SET", KEY, "1")
    writer.call("ACL", "SETUSER", "default", "-multi")
    tap = ReplicationTap(bus_server)
    writer.pipeline([("APPEND", KEY, "2"), ("SET", KEY, "1"), ("APPEND", KEY, "2")])
    seen = [write for write in collect(tap) if write.key in (KEY, keys.NOT_MIRRORED)]
    tap.close()
    assert [write.key for write in seen] == [keys.NOT_MIRRORED, KEY, KEY]
    assert seen[-1].value == b"12"


@pytest.mark.parametrize(
    "value", [b"", b"1", b"-7", b"300", b"-70000", b"123456789012", b"x" * 40, b"ab" * 9000, bytes(range(256)) * 80]
)
def test_every_form_in_which_a_server_dumps_a_string_is_read(writer: Connection, value: bytes) -> None:
    writer.call("SET", "x", value)
    assert string_in(writer.call("DUMP", "x")) == value


def test_dump_of_another_type_is_no_string(writer: Connection) -> None:
    writer.call("RPUSH", "x", "1")
    assert string_in(writer.call("DUMP", "x")) is None


@given(st.binary(max_size=60))
def test_bytes_that_are_no_dump_are_no_string_and_no_error(data: bytes) -> None:
    value = string_in(b"\0" + data)
    assert value is None or isinstance(value, bytes)
