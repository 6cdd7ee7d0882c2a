"""The second-best tap: what it sees, what it says of it, and that it invents nothing."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Iterator

import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Position, notifications
from station.bus.tap.base import TapRefused
from station.bus.tap.notifications import NotificationTap
from station.errors import BusError
from tests.bus.tap.conftest import Collect
from tests.bus.tap.traffic import read, read_until_lost
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture
def tap(bus_server: BusAddress) -> Iterator[NotificationTap]:
    tap = NotificationTap(bus_server)
    yield tap
    tap.close()


def test_every_write_that_is_read_in_time_arrives_byte_for_byte(tap: NotificationTap, writer: Connection) -> None:
    for number in range(200):
        value, stamp = os.urandom(60_000 if number % 20 == 0 else 100), b"%d 1 2 s" % number
        writer.call("MSET", "a", value, "a@", stamp)
        assert [write[:3] for write in read(tap, 1)] == [("a", value, stamp)]


def test_foreign_write_carries_no_stamp(tap: NotificationTap, writer: Connection) -> None:
    writer.call("SET", "a", "1")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", None)]


def test_foreign_write_over_a_native_key_does_not_inherit_its_stamp(tap: NotificationTap, writer: Connection) -> None:
    writer.call("MSET", "a", "1", "a@", "s")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", b"s")]
    writer.call("SET", "a", "2")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"2", None)]


def test_foreign_write_of_the_same_bytes_over_a_native_key_is_told_by_the_next_one(
    tap: NotificationTap, writer: Connection
) -> None:
    writer.call("MSET", "a", "1", "a@", "s")
    read(tap, 1)
    writer.pipeline([("SET", "a", "1")] * 2)
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", None)]


def test_native_write_is_delivered_once_under_load(tap: NotificationTap, writer: Connection, collect: Collect) -> None:
    for number in range(3000):
        writer.call("MSET", "a", b"%d" % number, "a@", b"%d 1 2 s" % number)
    seen = collect(tap)
    assert [write.key for write in seen] == ["a"] * len(seen)
    assert all(write.stamp == (write.value or b"") + b" 1 2 s" for write in seen)
    assert max(Counter(write.stamp for write in seen).values()) == 1
    assert [int(write.value or b"") for write in seen] == sorted(int(write.value or b"") for write in seen)


def test_deletion_and_expiry_arrive(tap: NotificationTap, writer: Connection) -> None:
    writer.call("MSET", "a", "1", "a@", "s", "b", "2")
    read(tap, 2)
    writer.call("DEL", "a", "a@")
    assert [write[:3] for write in read(tap, 1)] == [("a", None, None)]
    writer.call("PEXPIRE", "b", 1)
    wait_until(lambda: writer.call("EXISTS", "b") == 0)
    assert [write[:3] for write in read(tap, 1)] == [("b", None, None)]


def test_change_of_the_expiry_alone_is_no_write(tap: NotificationTap, writer: Connection, collect: Collect) -> None:
    writer.call("SET", "a", "1")
    read(tap, 1)
    writer.call("EXPIRE", "a", 100)
    writer.call("PERSIST", "a")
    assert collect(tap) == []


def test_keys_that_are_no_strings_are_left_out(tap: NotificationTap, writer: Connection, collect: Collect) -> None:
    writer.call("CONFIG", "SET", "notify-keyspace-events", "KA")
    writer.call("HSET", "h", "f", "v")
    assert collect(tap) == []


def test_other_databases_and_the_probe_are_left_out(tap: NotificationTap, writer: Connection, collect: Collect) -> None:
    writer.pipeline([("SELECT", 1), ("SET", "a", "1"), ("SELECT", 0)])
    NotificationTap(tap._address).close()
    assert collect(tap) == []


def test_notifications_are_switched_on_beside_those_of_others(bus_server: BusAddress, writer: Connection) -> None:
    writer.call("CONFIG", "SET", "notify-keyspace-events", "El")
    tap = NotificationTap(bus_server)
    assert set("ElK$gx") <= set(writer.call("CONFIG", "GET", "notify-keyspace-events")[1].decode())
    tap.close()


def test_user_who_may_not_configure_can_use_notifications_that_are_on(
    bus_server: BusAddress, writer: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "_IDLE_CHECK_S", 0.05)
    writer.call("ACL", "SETUSER", "default", "-config")
    tap = NotificationTap(bus_server)
    writer.call("SET", "a", "1")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", None)]
    assert tap.read(0.3) == [], "that it may not ask what the server tells is no loss"
    writer.call("SET", "a", "2")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"2", None)]
    tap.close()


def test_notifications_that_are_off_and_may_not_be_switched_on_are_refused(
    bus_server: BusAddress, writer: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "_ARM_TIMEOUT_S", 0.3)
    writer.call("CONFIG", "SET", "notify-keyspace-events", "")
    writer.call("ACL", "SETUSER", "default", "-config")
    with pytest.raises(TapRefused, match="notifications"):
        NotificationTap(bus_server)


def test_user_who_may_not_subscribe_is_refused(bus_server: BusAddress, writer: Connection) -> None:
    writer.call("ACL", "SETUSER", "default", "-psubscribe")
    with pytest.raises(TapRefused, match="subscriptions"):
        NotificationTap(bus_server)


def test_resumption_is_answered_with_a_hole(bus_server: BusAddress) -> None:
    tap = NotificationTap(bus_server, Position("0" * 40, 1))
    assert (tap.resumed, tap.is_lossless, tap.position()) == (False, False, None)
    tap.close()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_killed_or_frozen_server_is_an_error(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch, how: signal.Signals
) -> None:
    monkeypatch.setattr(notifications, "_IDLE_CHECK_S", 0.3)
    folder = tmp_path_factory.mktemp("gone")
    with RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock")) as server:
        tap = NotificationTap(server.address)
        tap._values.set_timeout(0.5)
        os.kill(server.pid, how)
        with pytest.raises(BusError):
            read_until_lost(tap)
        tap.close()
        os.kill(server.pid, signal.SIGKILL)


def test_who_switches_notifications_off_for_all_is_an_error_and_the_next_tap_switches_them_on(
    bus_server: BusAddress, writer: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "_IDLE_CHECK_S", 0.1)
    tap = NotificationTap(bus_server)
    writer.call("CONFIG", "SET", "notify-keyspace-events", "Ex")
    with pytest.raises(BusError, match=r"set notify-keyspace-events to 'xE'.* keep K[$]gx"):
        read_until_lost(tap)
    tap.close()
    tap = NotificationTap(bus_server)
    writer.call("SET", "a", "1")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", None)]
    tap.close()


def test_of_keys_without_end_the_newest_are_remembered_and_the_others_counted(
    bus_server: BusAddress, writer: Connection, collect: Collect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "MOST_KEYS", 50)
    tap = NotificationTap(bus_server)
    for number in range(300):
        writer.call("SET", f"invented{number}", "1")
        writer.call("MSET", "a", "same", "a@", str(number))
    seen = collect(tap)
    assert len({write.key for write in seen}) == 301
    assert max(len(tap._delivered), len(tap._unstamped)) <= 50
    assert tap.forgotten >= 250
    tap.close()
