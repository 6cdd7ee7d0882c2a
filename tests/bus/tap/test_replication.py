"""The lossless tap against a real server: nothing missing, nothing changed, nothing invented."""

from __future__ import annotations

import os
import random
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection, pack
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Position, Write, link
from station.bus.tap.replication import ReplicationTap
from station.errors import BusError
from tests.bus.tap.conftest import Collect
from tests.waiting import wait_until


@pytest.fixture
def tap(bus_server: BusAddress) -> Iterator[ReplicationTap]:
    tap = ReplicationTap(bus_server)
    yield tap
    tap.close()


def test_every_write_arrives_in_order_and_byte_for_byte(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    written = _random_writes(3000)
    _write_all(writer, written)
    assert _content(collect(tap)) == written


def test_write_arrives_within_its_stamp_of_arrival(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    before_ns = time.monotonic_ns()
    writer.call("SET", "a", "1")
    (write,) = collect(tap)
    assert before_ns <= write.mono_ns <= time.monotonic_ns()


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
    assert _content(collect(tap)) == [("a", b"1", b"s1"), ("b", b"2", b"s2"), ("a", b"foreign", None)]


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
    assert _content(collect(tap))[3:] == [("a", None, None), ("b", None, None), ("c", None, None)]


def test_flush_arrives_as_deletions(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    writer.call("SET", "a", "1")
    writer.call("FLUSHALL")
    assert _content(collect(tap)) == [("a", b"1", None), ("a", None, None)]


def test_writes_of_a_transaction_and_of_a_script_arrive(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    writer.pipeline([("MULTI",), ("SET", "a", "1"), ("MSET", "b", "2", "b@", "s"), ("EXEC",)])
    writer.call(
        "EVAL", "redis.call('SET', KEYS[1], ARGV[1]); return redis.call('SET', KEYS[2], ARGV[1])", 2, "c", "d", 3
    )
    expected = [("a", b"1", None), ("b", b"2", b"s"), ("c", b"3", None), ("d", b"3", None)]
    assert _content(collect(tap)) == expected


def test_only_the_tapped_database_is_seen(bus_server: BusAddress, writer: Connection) -> None:
    tap = ReplicationTap(msgspec.structs.replace(bus_server, db=3))
    for db in (0, 3, 1, 3):
        writer.pipeline([("SELECT", db), ("SET", "a", db)])
    assert _content(_read(tap, 2)) == [("a", b"3", None)] * 2
    assert tap.read(0.05) == []
    tap.close()


def test_probes_are_not_delivered_and_two_taps_see_the_same(
    bus_server: BusAddress, tap: ReplicationTap, writer: Connection
) -> None:
    second = ReplicationTap(bus_server)
    writer.call("SET", "a", "1")
    assert _content(_read(tap, 1)) == _content(_read(second, 1)) == [("a", b"1", None)]
    second.close()


def test_offset_is_exactly_the_servers_own(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    _write_all(writer, _random_writes(500))
    writer.pipeline([("MULTI",), ("SELECT", 2), ("set", "x", "1"), ("INCR", "n"), ("EXEC",), ("SELECT", 0)])
    writer.call("SET", "e", "1", "PX", 1)
    collect(tap)

    def agrees() -> bool:  # the server's keep-alive moves its offset every second
        servers = int(_info(writer)["master_repl_offset"])
        tap.read(0.01)
        return tap.position().offset == servers

    wait_until(agrees)
    assert tap.position().replication_id == _info(writer)["master_replid"]


def test_cut_link_is_resumed_without_a_hole(bus_server: BusAddress, writer: Connection, collect: Collect) -> None:
    tap = ReplicationTap(bus_server)
    written = _random_writes(6000, big_every=300)
    _write_all(writer, written[:1000])
    seen = _content(collect(tap))
    for start in (1000, 3000, 5000):
        tap.close()
        _write_all(writer, written[start : start + (2000 if start < 5000 else 1000)])
        tap = ReplicationTap(bus_server, tap.position())
        assert tap.resumed is True
        seen += _content(collect(tap))
    tap.close()
    assert seen == written
    assert _info(writer)["sync_full"] == "1"


def test_link_that_the_server_cuts_in_mid_stream_is_resumed_without_a_hole(
    bus_server: BusAddress, writer: Connection
) -> None:
    """The cut falls anywhere, also in mid command; what had been read stays read, and nothing is read twice."""
    tap, seen = ReplicationTap(bus_server), []
    written = _random_writes(8000, big_every=50)
    writing = threading.Thread(target=_write_slowly, args=(bus_server, written))
    writing.start()
    cuts = 0
    while len(seen) < len(written):
        try:
            seen += _content(tap.read(0.2))
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
    _read(tap, 1)
    wait_until(lambda: tap.read(0.01) == [] and tap.position().db == 1)
    tap.close()
    writer.call("SET", "a", "still in database 1")
    tap = ReplicationTap(bus_server, tap.position())
    writer.pipeline([("SELECT", 0), ("SET", "a", "back in database 0")])
    assert tap.resumed is True
    assert [write.value for write in _read(tap, 1)] == [b"back in database 0"]
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
    assert _content(_read(tap, 1)) == [("a", b"1", None)]
    tap.close()


def test_hole_after_the_backlog_overran_is_told(bus_server: BusAddress, writer: Connection, collect: Collect) -> None:
    writer.call("CONFIG", "SET", "repl-backlog-size", 16384)
    tap = ReplicationTap(bus_server)
    assert tap.resumed is None
    tap.close()
    _write_all(writer, [("a", os.urandom(1000), None)] * 3000)
    tap = ReplicationTap(bus_server, tap.position())
    assert tap.resumed is False
    writer.call("SET", "b", "1")
    assert _content(collect(tap)) == [("b", b"1", None)]
    tap.close()


def test_restart_of_the_server_is_a_hole(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("again")
    with _server(folder) as server:
        tap = ReplicationTap(server.address)
        tap.close()
    with _server(folder) as server:
        tap = ReplicationTap(server.address, tap.position())
        assert tap.resumed is False
        tap.close()


def test_position_of_a_stranger_is_a_hole(bus_server: BusAddress) -> None:
    tap = ReplicationTap(bus_server, Position("0" * 40, 12345))
    assert tap.resumed is False
    tap.close()


def test_server_that_took_over_continues_the_history_under_a_new_id(tmp_path_factory: pytest.TempPathFactory) -> None:
    port = _free_port()
    first_folder, second_folder = tmp_path_factory.mktemp("first"), tmp_path_factory.mktemp("second")
    options = ServerOptions(folder=first_folder, socket=first_folder / "bus.sock", tcp_port=port)
    with RedisServer.start(options) as first, _server(second_folder) as second:
        tap = ReplicationTap(first.address)
        with closing(Connection(second.address, timeout_s=5.0)) as heir:
            heir.call("REPLICAOF", "127.0.0.1", port)
            wait_until(lambda: _info(heir).get("master_link_status") == "up")
            tap.read(0.0)
            tap.close()
            position = tap.position()
            wait_until(lambda: int(_info(heir)["slave_repl_offset"]) >= position.offset)
            heir.call("REPLICAOF", "NO", "ONE")
            heir.call("SET", "a", "heir")
            tap = ReplicationTap(second.address, position)
            assert tap.resumed is True
            assert tap.position().replication_id == _info(heir)["master_replid"] != position.replication_id
            assert _content(_read(tap, 1)) == [("a", b"heir", None)]
            tap.close()


def test_link_lives_on_while_nobody_writes_and_nobody_reads(
    tap: ReplicationTap, writer: Connection, collect: Collect
) -> None:
    writer.call("CONFIG", "SET", "repl-timeout", 2)
    tap._link.silence_limit_s = 2.5  # a reader that was held up must not take its own absence for the server's
    time.sleep(5.0)  # two and a half times as long as a link without acknowledgements may live
    writer.call("SET", "a", "1")
    assert _content(collect(tap)) == [("a", b"1", None)]
    assert _info(writer)["sync_full"] == "1"


def test_link_without_acknowledgements_is_cut(
    bus_server: BusAddress, writer: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The counter-proof: with the acknowledger stopped the server hangs up, so the test above proves something."""
    monkeypatch.setattr(link, "_ACK_S", 3600.0)
    writer.call("CONFIG", "SET", "repl-timeout", 2)
    tap = ReplicationTap(bus_server)
    with pytest.raises(BusError, match="closed the replication link"):
        _read_until_lost(tap)
    tap.close()


def test_reader_that_is_held_up_loses_nothing(tap: ReplicationTap, writer: Connection, collect: Collect) -> None:
    images = [("image", os.urandom(60_000), None) for _ in range(8)] * 100
    _write_all(writer, images)  # 48 MB, more than any socket buffer, with nobody reading
    assert _content(collect(tap)) == images


def test_acknowledgement_on_request_lets_the_writer_wait_for_us(tap: ReplicationTap, writer: Connection) -> None:
    stop = threading.Event()
    reading = threading.Thread(target=lambda: [tap.read(0.05) for _ in iter(stop.is_set, True)])
    reading.start()
    writer.call("SET", "a", "1")
    assert writer.call("WAIT", 1, 5000) == 1
    stop.set()
    reading.join()


def test_killed_server_is_an_error(tmp_path_factory: pytest.TempPathFactory) -> None:
    with _server(tmp_path_factory.mktemp("killed")) as server:
        tap = ReplicationTap(server.address)
        os.kill(server.pid, signal.SIGKILL)
        with pytest.raises(BusError):
            _read_until_lost(tap)
        tap.close()


def test_frozen_server_is_an_error(tmp_path_factory: pytest.TempPathFactory) -> None:
    with _server(tmp_path_factory.mktemp("frozen")) as server:
        tap = ReplicationTap(server.address)
        tap._link.silence_limit_s = 1.5  # 5 s, as found from the server's keep-alive of 1 s, would prove no more
        os.kill(server.pid, signal.SIGSTOP)
        started = time.monotonic()
        with pytest.raises(BusError, match="silent"):
            _read_until_lost(tap)
        assert time.monotonic() - started < 10.0
        os.kill(server.pid, signal.SIGCONT)
        tap.close()


def test_quiet_bus_is_not_taken_for_a_frozen_one(tap: ReplicationTap) -> None:
    tap._link.silence_limit_s = 2.5  # the server's keep-alive comes every second
    until = time.monotonic() + 3.0
    while time.monotonic() < until:
        assert tap.read(0.2) == []


def test_reading_a_closed_tap_is_an_error(tap: ReplicationTap) -> None:
    tap.close()
    tap.close()
    with pytest.raises(BusError):
        tap.read(0.1)


def test_read_waits_no_longer_than_it_was_told(tap: ReplicationTap) -> None:
    started = time.monotonic()
    assert tap.read(0.2) == []
    assert 0.2 <= time.monotonic() - started < 2.0


def test_tap_over_tcp_sees_the_same(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("tcp")
    with RedisServer.start(ServerOptions(folder=folder, socket=None, tcp_port=_free_port())) as server:
        tap = ReplicationTap(server.address)
        writer = Connection(server.address, timeout_s=5.0)
        written = _random_writes(500)
        _write_all(writer, written)
        assert _content(_read(tap, 500)) == written
        writer.close()
        tap.close()


Content = tuple[str, bytes | None, bytes | None]


def _random_writes(count: int, *, big_every: int = 100) -> list[Content]:
    """Foreign and native writes of random bytes, with 60 KB ones in between."""
    dice = random.Random(count)
    writes: list[Content] = []
    for number in range(count):
        size = 60_000 if number % big_every == big_every - 1 else dice.choice((0, 1, 9, 10, 99, 100, 550, 1500))
        stamp = b"%d 1 2 test.1.00000000.0000" % number if dice.random() < 0.5 else None
        writes.append((f"key_{dice.randrange(8)}", dice.randbytes(size), stamp))
    return writes


def _packed(writes: list[Content]) -> bytes:
    return b"".join(
        pack("SET", key, value or b"") if stamp is None else pack("MSET", key, value or b"", f"{key}@", stamp)
        for key, value, stamp in writes
    )


def _write_all(writer: Connection, writes: list[Content]) -> None:
    for start in range(0, len(writes), 100):
        part = writes[start : start + 100]
        writer.send_packed(_packed(part), len(part))


def _write_slowly(address: BusAddress, writes: list[Content]) -> None:
    connection = Connection(address, timeout_s=10.0)
    for start in range(0, len(writes), 20):
        part = writes[start : start + 20]
        connection.send_packed(_packed(part), len(part))
        time.sleep(0.002)
    connection.close()


def _content(writes: list[Write]) -> list[Content]:
    return [write[:3] for write in writes]


def _read(tap: ReplicationTap, count: int) -> list[Write]:
    seen: list[Write] = []
    wait_until(lambda: seen.extend(tap.read(0.1)) or len(seen) >= count)
    return seen


def _read_until_lost(tap: ReplicationTap) -> None:
    wait_until(lambda: tap.read(0.1) is None)


def _info(connection: Connection) -> dict[str, str]:
    lines = connection.call("INFO", "replication").decode() + connection.call("INFO", "stats").decode()
    return dict(line.split(":", 1) for line in lines.splitlines() if ":" in line)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def _server(folder: Path) -> RedisServer:
    return RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
