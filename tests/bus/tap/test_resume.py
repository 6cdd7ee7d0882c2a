"""Going on behind a position: without a hole and without anything twice, or else it is told."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import closing

import msgspec
import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Position
from station.bus.tap.replication import ReplicationTap
from station.errors import BusError
from tests.bus.tap.conftest import Collect
from tests.bus.tap.traffic import (
    content,
    free_port,
    info,
    random_writes,
    read,
    start_server,
    write_all,
    write_slowly,
)
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture
def tap(bus_server: BusAddress) -> Iterator[ReplicationTap]:
    tap = ReplicationTap(bus_server)
    yield tap
    tap.close()


def test_offset_is_exactly_the_servers_own(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    write_all(writer, random_writes(500))
    writer.pipeline([("MULTI",), ("SELECT", 2), ("set", "x", "1"), ("INCR", "n"), ("EXEC",), ("SELECT", 0)])
    writer.call("SET", "e", "1", "PX", 1)
    collect(tap)

    def agrees() -> bool:  # the server's keep-alive moves its offset every second
        servers = int(info(writer)["master_repl_offset"])
        tap.read(0.01)
        return tap.position().offset == servers

    wait_until(agrees)
    assert tap.position().replication_id == info(writer)["master_replid"]


def test_cut_link_is_resumed_without_a_hole(bus_server: BusAddress, writer: Connection, collect: Collect) -> None:
    tap = ReplicationTap(bus_server)
    written = random_writes(6000, big_every=300)
    write_all(writer, written[:1000])
    seen = content(collect(tap))
    for start in (1000, 3000, 5000):
        tap.close()
        write_all(writer, written[start : start + (2000 if start < 5000 else 1000)])
        tap = ReplicationTap(bus_server, tap.position())
        assert tap.resumed is True
        seen += content(collect(tap))
    tap.close()
    assert seen == written
    assert info(writer)["sync_full"] == "1"


def test_link_that_the_server_cuts_in_mid_stream_is_resumed_without_a_hole(
    bus_server: BusAddress, writer: Connection
) -> None:
    """The cut falls anywhere, also in mid command; what had been read stays read, and nothing is read twice."""
    tap, seen = ReplicationTap(bus_server), []
    written = random_writes(8000, big_every=50)
    writing = threading.Thread(target=write_slowly, args=(bus_server, written))
    writing.start()
    cuts = 0
    while len(seen) < len(written):
        try:
            seen += content(tap.read(0.2))
            if len(seen) // 1000 > cuts:
                cuts += 1
                writer.call("CLIENT", "KILL", "TYPE", "replica")
        except BusError:
            tap.close()
            tap = ReplicationTap(bus_server, tap.position())
            assert tap.resumed is True
    writing.join()
    tap.close()
    assert cuts >= 5
    assert seen == written


def test_resumption_remembers_which_database_was_selected(bus_server: BusAddress, writer: Connection) -> None:
    tap = ReplicationTap(bus_server)
    writer.pipeline([("SET", "a", "0"), ("SELECT", 1), ("SET", "a", "1")])
    read(tap, 1)
    wait_until(lambda: tap.read(0.01) == [] and tap.position().db == 1)
    tap.close()
    writer.call("SET", "a", "still in database 1")
    tap = ReplicationTap(bus_server, tap.position())
    writer.pipeline([("SELECT", 0), ("SET", "a", "back in database 0")])
    assert tap.resumed is True
    assert [write.value for write in read(tap, 1)] == [b"back in database 0"]
    tap.close()


def test_position_is_behind_what_was_read_not_behind_what_was_received(
    bus_server: BusAddress, writer: Connection
) -> None:
    tap = ReplicationTap(bus_server)
    position = tap.position()
    tap.close()
    writer.call("SET", "a", "1")
    for _ in range(3):  # each of these receives the write while arming, none of them reads it
        tap = ReplicationTap(bus_server, position)
        position = tap.position()
        tap.close()
    tap = ReplicationTap(bus_server, position)
    assert content(read(tap, 1)) == [("a", b"1", None)]
    tap.close()


def test_hole_after_the_backlog_overran_is_told(bus_server: BusAddress, writer: Connection, collect: Collect) -> None:
    writer.call("CONFIG", "SET", "repl-backlog-size", 16384)
    tap = ReplicationTap(bus_server)
    assert tap.resumed is None
    tap.close()
    write_all(writer, [("a", os.urandom(1000), None)] * 3000)
    tap = ReplicationTap(bus_server, tap.position())
    assert tap.resumed is False
    writer.call("SET", "b", "1")
    assert content(collect(tap)) == [("b", b"1", None)]
    tap.close()


def test_restart_of_the_server_is_a_hole(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("again")
    with start_server(folder) as server:
        tap = ReplicationTap(server.address)
        tap.close()
    with start_server(folder) as server:
        tap = ReplicationTap(server.address, tap.position())
        assert tap.resumed is False
        tap.close()


def test_position_of_a_stranger_is_a_hole(bus_server: BusAddress) -> None:
    tap = ReplicationTap(bus_server, Position("0" * 40, 12345))
    assert tap.resumed is False
    tap.close()


def test_server_that_took_over_continues_the_history_under_a_new_id(tmp_path_factory: pytest.TempPathFactory) -> None:
    port = free_port()
    first_folder, second_folder = tmp_path_factory.mktemp("first"), tmp_path_factory.mktemp("second")
    options = ServerOptions(folder=first_folder, socket=first_folder / "bus.sock", tcp_port=port)
    with RedisServer.start(options) as first, start_server(second_folder) as second:
        tap = ReplicationTap(first.address)
        with closing(Connection(second.address, timeout_s=5.0)) as heir:
            heir.call("REPLICAOF", "127.0.0.1", port)
            wait_until(lambda: info(heir).get("master_link_status") == "up")
            tap.read(0.0)
            tap.close()
            position = tap.position()
            wait_until(lambda: int(info(heir)["slave_repl_offset"]) >= position.offset)
            heir.call("REPLICAOF", "NO", "ONE")
            heir.call("SET", "a", "heir")
            tap = ReplicationTap(second.address, position)
            assert tap.resumed is True
            assert tap.position().replication_id == info(heir)["master_replid"] != position.replication_id
            assert content(read(tap, 1)) == [("a", b"heir", None)]
            tap.close()


def test_a_tap_that_goes_on_leaves_what_waited_at_the_server_until_it_is_read(
    bus_server: BusAddress, writer: Connection
) -> None:
    tap = ReplicationTap(bus_server)
    tap.close()
    write_all(writer, [("a", bytes(100_000), None)] * 300)
    tap = ReplicationTap(bus_server, tap.position())
    before = tap.position()
    assert (tap.is_catching_up, tap.may_wait()) == (True, True)
    assert len(read(tap, 300)) == 300
    assert tap.position().offset > before.offset + 30_000_000
    wait_until(lambda: tap.read(0.01) == [] and not tap.is_catching_up)
    tap.close()


def test_a_tap_may_wait_while_the_server_keeps_it_all_twice_over(bus_server: BusAddress, writer: Connection) -> None:
    writer.call("CONFIG", "SET", "repl-backlog-size", 20_000_000)
    tap = ReplicationTap(bus_server)
    tap.close()
    write_all(writer, [("a", bytes(100_000), None)] * 120)
    tap = ReplicationTap(bus_server, tap.position())
    assert tap.resumed is True
    assert not tap.may_wait()
    read(tap, 40)
    wait_until(tap.may_wait)
    assert tap.is_catching_up
    tap.close()


def test_what_the_output_buffer_takes_counts_as_well(bus_server: BusAddress, writer: Connection) -> None:
    writer.call("CONFIG", "SET", "client-output-buffer-limit", "replica 0 3000000 60")
    tap = ReplicationTap(bus_server)
    tap.close()
    tap = ReplicationTap(bus_server, tap.position())
    assert tap.may_wait()
    write_all(writer, [("a", bytes(100_000), None)] * 20)
    wait_until(lambda: not tap.may_wait())
    tap.close()


def test_where_the_server_does_not_say_how_much_it_keeps_nothing_waits(
    bus_server: BusAddress, writer: Connection
) -> None:
    writer.call("ACL", "SETUSER", "mute", "on", ">secret", "~*", "&*", "+@all", "-info", "-config")
    mute = msgspec.structs.replace(bus_server, username="mute", password="secret")
    tap = ReplicationTap(mute)
    tap.close()
    writer.call("SET", "a", "1")
    tap = ReplicationTap(mute, tap.position())
    assert (tap.resumed, tap.may_wait()) == (True, False)
    assert content(read(tap, 1)) == [("a", b"1", None)]
    wait_until(lambda: tap.read(0.01) == [] and not tap.is_catching_up)
    tap.close()
