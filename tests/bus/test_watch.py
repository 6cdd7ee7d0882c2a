"""The newest value at hand, and how old it is, on a real server."""

from __future__ import annotations

import math
import os
import signal
import time
from pathlib import Path

import redis

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.watch import Watch
from tests.bus.proxy import Proxy
from tests.waiting import DEADLINE_S, wait_until


def test_a_value_that_was_there_before_has_no_age(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion") as bus:
        bus.publish({"k": b"old"})
        with bus.watch(["k"]) as watch:
            sample = watch.latest("k")
            assert sample is not None
            assert sample.value == b"old"
            assert sample.age_s() == math.inf
            assert watch.latest("k", max_age_s=1e9) is None


def test_closing_waits_for_nothing(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion") as bus:
        began = time.monotonic()
        for _ in range(20):
            bus.watch(["k"]).close()
        assert time.monotonic() - began < 5.0, "one that sits out its wait of a second takes 20"


def test_a_new_value_arrives_with_its_stamp_and_age(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion") as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"new"})
        sample = watch.wait("k", after=None, timeout_s=DEADLINE_S)
        assert sample is not None
        assert sample.value == b"new"
        assert sample.stamp is not None
        assert sample.arrived_ns is not None
        assert sample.arrived_ns >= sample.stamp.mono_ns
        assert sample.age_s() < DEADLINE_S
        assert watch.wait("k", after=sample, timeout_s=0.05) is None


def test_the_newest_of_many_writes_ends_in_the_slot(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion") as bus, bus.watch(["k"]) as watch:
        for n in range(2000):
            bus.publish({"k": b"%d" % n})
        wait_until(lambda: (sample := watch.latest("k")) is not None and sample.value == b"1999")


def test_a_foreign_writer_is_seen_even_over_a_native_stamp(bus_server: BusAddress) -> None:
    foreign = redis.Redis(unix_socket_path=bus_server.socket or "")
    with foreign, Bus(bus_server, name="motion") as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"native"})
        native = watch.wait("k", after=None, timeout_s=DEADLINE_S)
        foreign.set("k", b"foreign")
        sample = watch.wait("k", after=native, timeout_s=DEADLINE_S)
        assert sample is not None
        assert (sample.value, sample.stamp) == (b"foreign", None)
        foreign.set("k", b"foreign")
        again = watch.wait("k", after=sample, timeout_s=DEADLINE_S)
        assert again is not None, "the same bytes written again are a fresh command"
        bus.publish({"k": b"native"})
        back = watch.wait("k", after=again, timeout_s=DEADLINE_S)
        assert back is not None
        assert back.stamp is not None


def test_a_deleted_key_leaves_its_slot(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion") as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"v"})
        wait_until(lambda: watch.latest("k") is not None)
        bus.call("DEL", "k")
        wait_until(lambda: watch.latest("k") is None)


def test_a_watch_outlives_a_killed_server_and_keeps_telling_the_age(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    server = RedisServer.start(options)
    with Bus(server.address, name="motion") as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"1"})
        first = watch.wait("k", after=None, timeout_s=DEADLINE_S)
        assert first is not None
        os.kill(server.pid, signal.SIGKILL)
        server.stop()
        wait_until(lambda: not watch.is_connected)
        assert watch.latest("k") is first
        with RedisServer.start(options):
            wait_until(lambda: watch.is_connected and bus.publish({"k": b"2"}))
            second = watch.wait("k", after=first, timeout_s=DEADLINE_S)
            assert second is not None
            assert second.value == b"2"


def test_after_a_cut_it_reads_again_what_changed_meanwhile_and_calls_none_of_it_fresh(bus_server: BusAddress) -> None:
    wanted = ["changed", "overwritten", "same", "gone"]
    with (
        Proxy(bus_server) as network,
        Bus(bus_server, name="motion", timeout_s=5.0) as bus,
        Watch(network.address, wanted) as watch,
    ):
        bus.publish({key: b"before" for key in wanted})
        wait_until(lambda: all(watch.latest(key) for key in wanted))
        before = {key: watch.latest(key) for key in wanted}
        network.cut()
        wait_until(lambda: not watch.is_connected)
        bus.publish({"changed": b"meanwhile"})
        bus.call("SET", "overwritten", b"by a stock script")
        bus.call("DEL", "gone")
        network.mend()
        wait_until(lambda: watch.connections == 2)
        after = {key: watch.latest(key) for key in wanted}
        assert after["same"] is before["same"]
        assert after["gone"] is before["gone"]
        for key, value in (("changed", b"meanwhile"), ("overwritten", b"by a stock script")):
            sample = after[key]
            assert sample is not None
            assert (sample.value, sample.age_s()) == (value, math.inf)
            assert watch.latest(key, max_age_s=1e9) is None
        assert watch.wait("changed", after=None, timeout_s=0.05) is None
        bus.publish({"changed": b"after"})
        fresh = watch.wait("changed", after=after["changed"], timeout_s=DEADLINE_S)
        assert fresh is not None
        assert (fresh.value, fresh.age_s() < DEADLINE_S) == (b"after", True)


def test_a_frozen_server_is_noticed(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion") as bus, bus.watch(["k"]) as watch:
        pid = int(bus.call("INFO", "server").split(b"process_id:")[1].split()[0])
        os.kill(pid, signal.SIGSTOP)
        try:
            wait_until(lambda: not watch.is_connected)
        finally:
            os.kill(pid, signal.SIGCONT)
        wait_until(lambda: watch.is_connected)


def test_a_server_that_refuses_notifications_is_polled(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="admin") as admin:
        admin.call("ACL", "SETUSER", "plain", "on", ">pw", "~*", "&*", "+@all", "-config")
        address = BusAddress(socket=bus_server.socket, username="plain", password="pw")
        admin.call("CONFIG", "SET", "notify-keyspace-events", "")
        with Bus(address, name="motion") as bus, Watch(address, ["k"]) as watch:
            for n in range(5):
                bus.publish({"k": b"%d" % n})
                wait_until(lambda n=n: (s := watch.latest("k")) is not None and s.value == b"%d" % n)
            sample = watch.latest("k")
            assert sample is not None
            assert time.monotonic_ns() - (sample.arrived_ns or 0) < DEADLINE_S * 1e9
