"""The lossless tap against a real server: nothing missing, nothing changed, nothing invented."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator

import msgspec
import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Write, link
from station.bus.tap.replication import ReplicationTap
from station.errors import BusError
from tests.bus.tap.conftest import Collect
from tests.bus.tap.traffic import (
    content,
    free_port,
    info,
    random_writes,
    read,
    read_until_lost,
    start_server,
    write_all,
)
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture
def tap(bus_server: BusAddress) -> Iterator[ReplicationTap]:
    tap = ReplicationTap(bus_server)
    yield tap
    tap.close()


def test_every_write_arrives_in_order_and_byte_for_byte(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    written = random_writes(3000)
    write_all(writer, written)
    assert content(collect(tap)) == written


def test_write_arrives_within_its_stamp_of_arrival(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    before_ns = time.monotonic_ns()
    writer.call("SET", "a", "1")
    (write,) = collect(tap)
    assert before_ns <= write.mono_ns <= time.monotonic_ns()


def test_what_is_written_while_the_tap_is_armed_is_not_lost(
    bus_server: BusAddress, writer: Connection, collect: Collect, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_probe = ReplicationTap._write_probe

    def after_another(tap: ReplicationTap) -> bytes:
        writer.call("SET", "early", "1")
        return write_probe(tap)

    monkeypatch.setattr(ReplicationTap, "_write_probe", after_another)
    tap = ReplicationTap(bus_server)
    writer.call("SET", "late", "1")
    assert [write.key for write in collect(tap)] == ["early", "late"]
    tap.close()


def test_what_was_there_before_is_not_a_write(bus_server: BusAddress, writer: Connection, collect: Collect) -> None:
    writer.call("SET", "old", b"\0" * 3_000_000)
    tap = ReplicationTap(bus_server)
    assert collect(tap) == []
    tap.close()


def test_snapshot_with_its_length_in_front_is_skipped_too(
    bus_server: BusAddress, writer: Connection, collect: Collect
) -> None:
    writer.call("CONFIG", "SET", "repl-diskless-sync", "no")
    writer.call("SET", "old", os.urandom(3_000_000))
    tap = ReplicationTap(bus_server)
    writer.call("SET", "new", "1")
    assert [write.key for write in collect(tap)] == ["new"]
    tap.close()


def test_native_write_carries_the_stamp_of_its_own_command(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    writer.call("MSET", "a", "1", "a@", "s1", "b", "2", "b@", "s2")
    writer.call("SET", "a", "foreign")
    assert content(collect(tap)) == [("a", b"1", b"s1"), ("b", b"2", b"s2"), ("a", b"foreign", None)]


def test_every_form_of_set_arrives_as_its_value(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    forms = ["SET a 1", "set a 2 EX 100", "SETEX a 100 3", "PSETEX a 100000 4", "GETSET a 5", "SET a 6 GET"]
    forms += ["SET a 7 XX KEEPTTL", "MSETNX b 8", "SETNX c 9", "INCRBYFLOAT f 10"]
    for form in forms:
        writer.call(*form.split())
    assert [write.value for write in collect(tap)] == [b"%d" % number for number in range(1, 11)]


def test_deletion_and_expiry_arrive(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    writer.call("MSET", "a", "1", "a@", "s", "b", "2", "c", "3")
    writer.call("DEL", "a", "a@")
    writer.call("GETDEL", "b")
    writer.call("PEXPIRE", "c", 1)
    wait_until(lambda: writer.call("EXISTS", "c") == 0)
    assert content(collect(tap))[3:] == [("a", None, None), ("b", None, None), ("c", None, None)]


def test_flush_arrives_as_deletions(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    writer.call("SET", "a", "1")
    writer.call("FLUSHALL")
    assert content(collect(tap)) == [("a", b"1", None), ("a", None, None)]


def test_writes_of_a_transaction_and_of_a_script_arrive(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    writer.pipeline([("MULTI",), ("SET", "a", "1"), ("MSET", "b", "2", "b@", "s"), ("EXEC",)])
    writer.call(
        "EVAL", "redis.call('SET', KEYS[1], ARGV[1]); return redis.call('SET', KEYS[2], ARGV[1])", 2, "c", "d", 3
    )
    expected = [("a", b"1", None), ("b", b"2", b"s"), ("c", b"3", None), ("d", b"3", None)]
    assert content(collect(tap)) == expected


def test_only_the_tapped_database_is_seen(bus_server: BusAddress, writer: Connection) -> None:
    tap = ReplicationTap(msgspec.structs.replace(bus_server, db=3))
    for db in (0, 3, 1, 3):
        writer.pipeline([("SELECT", db), ("SET", "a", db)])
    assert content(read(tap, 2)) == [("a", b"3", None)] * 2
    assert tap.read(0.05) == []
    tap.close()


def test_probes_are_not_delivered_and_two_taps_see_the_same(
    bus_server: BusAddress, tap: ReplicationTap, writer: Connection
) -> None:
    second = ReplicationTap(bus_server)
    writer.call("SET", "a", "1")
    assert content(read(tap, 1)) == content(read(second, 1)) == [("a", b"1", None)]
    second.close()


def test_link_lives_on_while_nobody_writes_and_nobody_reads(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    tap._link.silence_limit_s = 2.5  # a reader that was held up must not take its own absence for the server's
    unread_s, known = time.monotonic(), acknowledgements(writer)
    wait_until(lambda: acknowledgements(writer) >= known + 5 and time.monotonic() - unread_s > 3.0)
    assert tap.read(0.0) == []
    tap._link.silence_limit_s = DEADLINE_S
    writer.call("SET", "a", "1")
    assert content(collect(tap)) == [("a", b"1", None)]
    assert info(writer)["sync_full"] == "1"


def acknowledgements(writer: Connection) -> int:
    """Return how many the server has taken."""
    stats = writer.call("INFO", "commandstats").decode()
    return int(stats.partition("cmdstat_replconf:calls=")[2].partition(",")[0])


def test_link_without_acknowledgements_is_cut(
    bus_server: BusAddress, writer: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The counter-proof: with the acknowledger stopped the server hangs up, so the test above proves something."""
    monkeypatch.setattr(link, "_ACK_S", 3600.0)
    writer.call("CONFIG", "SET", "repl-timeout", 2)
    tap = ReplicationTap(bus_server)
    with pytest.raises(BusError, match="closed the replication link"):
        read_until_lost(tap)
    tap.close()


def test_reader_that_is_held_up_loses_nothing(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    images = [("image", os.urandom(60_000), None) for _ in range(8)] * 100
    write_all(writer, images)  # 48 MB, more than any socket buffer, with nobody reading
    assert content(collect(tap)) == images


def test_acknowledgement_on_request_lets_the_writer_wait_for_us(tap: ReplicationTap, writer: Connection) -> None:
    stop = threading.Event()
    reading = threading.Thread(target=lambda: [tap.read(0.05) for _ in iter(stop.is_set, True)])
    reading.start()
    writer.call("SET", "a", "1")
    wait_until(lambda: writer.call("WAIT", 1, 1000) == 1)
    stop.set()
    reading.join()


def test_killed_server_is_an_error(tmp_path_factory: pytest.TempPathFactory) -> None:
    with start_server(tmp_path_factory.mktemp("killed")) as server:
        tap = ReplicationTap(server.address)
        os.kill(server.pid, signal.SIGKILL)
        with pytest.raises(BusError):
            read_until_lost(tap)
        tap.close()


def test_frozen_server_is_an_error(tmp_path_factory: pytest.TempPathFactory) -> None:
    with start_server(tmp_path_factory.mktemp("frozen")) as server:
        tap = ReplicationTap(server.address)
        tap._link.silence_limit_s = 1.5  # 5 s, as found from the server's keep-alive of 1 s, would prove no more
        os.kill(server.pid, signal.SIGSTOP)
        with pytest.raises(BusError, match="silent"):
            read_until_lost(tap)
        os.kill(server.pid, signal.SIGCONT)
        tap.close()


def test_quiet_bus_is_not_taken_for_a_frozen_one(tap: ReplicationTap) -> None:
    tap._link.silence_limit_s = DEADLINE_S
    seen: list[Write] = []
    for _ in range(3):
        heard_s = tap._link._heard_at  # the server's keep-alive comes every second
        wait_until(lambda heard_s=heard_s: seen.extend(tap.read(0.2)) or tap._link._heard_at > heard_s)  # type: ignore[misc]
    assert seen == []


def test_reading_a_closed_tap_is_an_error(tap: ReplicationTap) -> None:
    tap.close()
    tap.close()
    with pytest.raises(BusError):
        tap.read(0.1)


def test_tap_over_tcp_sees_the_same(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("tcp")
    with RedisServer.start(ServerOptions(folder=folder, socket=None, tcp_port=free_port())) as server:
        tap = ReplicationTap(server.address)
        writer = Connection(server.address, timeout_s=5.0)
        written = random_writes(500)
        write_all(writer, written)
        assert content(read(tap, 500)) == written
        writer.close()
        tap.close()
