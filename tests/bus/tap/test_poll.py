"""The last resort: what changed between two looks."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Position, Write, poll
from station.bus.tap.poll import PollTap
from station.errors import BusError
from tests.bus.tap.conftest import Collect
from tests.bus.tap.traffic import read, read_until_lost
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture
def tap(bus_server: BusAddress) -> Iterator[PollTap]:
    tap = PollTap(bus_server)
    yield tap
    tap.close()


def test_change_and_a_new_key_arrive_byte_for_byte(tap: PollTap, writer: Connection) -> None:
    for value in (os.urandom(100), os.urandom(60_000)):
        writer.call("MSET", "a", value, "a@", value[:9])
        assert [write[:3] for write in read(tap, 1)] == [("a", value, value[:9])]


def test_what_was_there_before_is_not_a_write(bus_server: BusAddress, writer: Connection, collect: Collect) -> None:
    writer.call("MSET", "a", "1", "a@", "s", "b", "2")
    tap = PollTap(bus_server)
    assert collect(tap) == []
    writer.call("SET", "a", "3")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"3", None)]
    tap.close()


def test_same_bytes_under_a_new_stamp_are_a_write(tap: PollTap, writer: Connection) -> None:
    for stamp in (b"1", b"2", b"3"):
        writer.call("MSET", "a", "same", "a@", stamp)
        assert [write[:3] for write in read(tap, 1)] == [("a", b"same", stamp)]


def test_foreign_write_over_a_native_key_does_not_inherit_its_stamp(tap: PollTap, writer: Connection) -> None:
    writer.call("MSET", "a", "1", "a@", "s")
    read(tap, 1)
    writer.call("SET", "a", "2")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"2", None)]


def test_deletion_and_expiry_arrive(tap: PollTap, writer: Connection) -> None:
    writer.call("MSET", "a", "1", "a@", "s", "b", "2")
    read(tap, 2)
    writer.call("DEL", "a", "a@")
    assert [write[:3] for write in read(tap, 1)] == [("a", None, None)]
    writer.call("PEXPIRE", "b", 1)
    assert [write[:3] for write in read(tap, 1)] == [("b", None, None)]


def test_keys_that_are_no_strings_the_probe_and_other_databases_are_left_out(
    tap: PollTap, writer: Connection, collect: Collect
) -> None:
    writer.call("HSET", "h", "f", "v")
    writer.pipeline([("SELECT", 1), ("SET", "a", "1"), ("SELECT", 0)])
    PollTap(tap._address).close()
    assert collect(tap) == []


def test_many_keys_are_all_looked_at(tap: PollTap, writer: Connection) -> None:
    names = [f"key_{number}" for number in range(3000)]
    writer.call("MSET", *(part for name in names for part in (name, "1")))
    assert sorted(write.key for write in read(tap, 3000)) == sorted(names)


def test_resumption_is_answered_with_a_hole(bus_server: BusAddress) -> None:
    tap = PollTap(bus_server, Position("0" * 40, 1))
    assert (tap.resumed, tap.is_lossless, tap.position()) == (False, False, None)
    tap.close()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_killed_or_frozen_server_is_an_error(tmp_path_factory: pytest.TempPathFactory, how: signal.Signals) -> None:
    folder = tmp_path_factory.mktemp("gone")
    with RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock")) as server:
        tap = PollTap(server.address)
        tap._connection.set_timeout(0.5)
        os.kill(server.pid, how)
        with pytest.raises(BusError):
            read_until_lost(tap)
        tap.close()
        os.kill(server.pid, signal.SIGKILL)


def test_of_keys_without_end_those_that_were_there_first_are_looked_at_and_the_others_counted(
    bus_server: BusAddress, writer: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(poll, "MOST_KEYS", 50)
    writer.call("SET", "a", "1")
    tap = PollTap(bus_server)
    writer.pipeline([("SET", f"invented{number}", "1") for number in range(300)])
    seen: list[Write] = []

    def has_looked() -> bool:
        seen.extend(tap.read(0.05))
        return tap.unseen_keys > 0

    wait_until(has_looked)
    assert tap.unseen_keys == 300 - len([write for write in seen if write.key.startswith("invented")])
    assert len(tap._contents) <= 50
    writer.call("SET", "a", "2")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"2", None)]
    tap.close()
