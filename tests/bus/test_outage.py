"""What a process suffered from its bus is told once, when it is over, and by how much."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from station.bus import client, keys, outage
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.outage import Outage, Outages
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import TapRefused, open_tap
from station.bus.tap.replication import ReplicationTap
from station.bus.watch import Watch
from station.clock import Clock
from station.errors import BusError
from tests.bus.answering import answering
from tests.bus.proxy import Proxy
from tests.faults.bus_station import frozen, pause, pid_of
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture(autouse=True)
def _told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outage, "_SETTLE_NS", 0)


def kill_clients(address: BusAddress, kind: str) -> None:
    with Bus(address, name="admin", timeout_s=5.0) as admin:
        admin.call("CLIENT", "KILL", "TYPE", kind, "SKIPME", "yes")


def test_a_frozen_server_is_a_silence_of_that_length(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="g1") as bus:
        pid = pid_of(bus_server)
        os.kill(pid, signal.SIGSTOP)
        bus.publish({"k": b"1"})
        began = time.monotonic()
        wait_until(lambda: bus.publish({"k": b"1"}) and time.monotonic() - began > 0.8)
        os.kill(pid, signal.SIGCONT)
        wait_until(lambda: bus.publish({"k": b"1"}) and not bus.is_late)
        (found,) = bus.outages.pop()
        assert found.kind == "bus-silent"
        detail = found.detail(time.monotonic_ns())
        assert detail["seconds"] > 0.7
        assert detail["began_ago_s"] >= detail["seconds"]
        assert (bus.lost_writes, bus.connections, bus.outages.pop()) == (0, 1, [])


def test_a_writer_that_was_frozen_itself_does_not_blame_the_server(bus_server: BusAddress) -> None:
    code = (
        "import select, sys\n"
        "from station.bus import outage\n"
        "from station.bus.address import parse\n"
        "from station.bus.client import Bus\n"
        "outage._SETTLE_NS = 0\n"
        "bus = Bus(parse(sys.argv[1]), name='g1', timeout_s=5.0)\n"
        "print('up', flush=True)\n"
        "while bus.publish({'k': b'1'}) and not select.select([sys.stdin], [], [], 0.0)[0]: pass\n"
        "print([found.kind for found in bus.outages.pop()])\n"
    )
    command = [sys.executable, "-c", code, bus_server.url]
    with (
        Bus(bus_server, name="test", timeout_s=5.0) as bus,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as writer,
    ):
        assert writer.stdout is not None
        assert writer.stdout.readline() == "up\n"
        for _ in range(4):
            with frozen(writer.pid):
                pause(0.6)  # longer than a silence that is told of
                before = bus.get(keys.stamp("k"))
            wait_until(lambda before=before: bus.get(keys.stamp("k")) != before)  # type: ignore[misc]
        out, _ = writer.communicate("", timeout=DEADLINE_S)
    assert out == "[]\n"


def test_a_cut_connection_costs_the_write_that_met_the_cut_and_is_there_again_for_the_next(
    bus_server: BusAddress,
) -> None:
    with Bus(bus_server, name="g1", timeout_s=5.0) as bus:
        for _ in range(3):
            kill_clients(bus_server, "normal")
            assert not bus.publish({"a": b"1", "b": b"2"})
            wait_until(lambda: bus.is_connected)
            assert bus.publish({"a": b"1", "b": b"2"})
        found = bus.outages.pop()
        assert [one.kind for one in found] == ["bus-back"] * 3
        assert [one.numbers["lost_writes"] for one in found] == [2] * 3
        assert all(str(bus_server) not in one.numbers["reason"] for one in found)
        assert (bus.lost_writes, bus.connections) == (6, 4)


def test_only_the_line_of_a_watch_is_cut_and_told_of(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="g1", timeout_s=5.0) as bus, bus.watch(["k"]) as watch:
        kill_clients(bus_server, "pubsub")
        wait_until(lambda: watch.connections == 2)
        assert [found.kind for found in bus.outages.pop()] == ["watch-back"]
        bus.publish({"k": b"1"})
        assert watch.wait("k", after=None, timeout_s=30) is not None


def test_what_a_server_refuses_is_counted_and_its_end_is_told(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="g1", timeout_s=5.0) as bus:
        for _ in range(2):
            bus.call("REPLICAOF", "127.0.0.1", "1")
            assert not bus.publish({"a": b"1", "b": b"2"})
            assert not bus.publish({"a": b"1"})
            assert bus.last_error.startswith(f"bus {bus_server} refuses writes: READONLY")
            bus.call("REPLICAOF", "NO", "ONE")
            assert bus.publish({"a": b"1"})
            assert bus.last_error == ""
            (found,) = bus.outages.pop()
            assert (found.kind, found.numbers["refused"]) == ("bus-refused", 3)
            assert found.numbers["reason"].startswith("refuses writes: READONLY")


def test_a_password_that_is_suddenly_asked_for_is_said_in_a_line(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="g1") as bus, Bus(bus_server, name="admin", timeout_s=5.0) as admin:
        admin.call("CONFIG", "SET", "requirepass", "secret")
        admin.call("CLIENT", "KILL", "TYPE", "normal", "SKIPME", "yes")
        assert not bus.publish({"k": b"1"})
        wait_until(lambda: "asks for a password" in bus.last_error)
        assert "\n" not in bus.last_error
        admin.call("CONFIG", "SET", "requirepass", "")
        wait_until(lambda: bus.is_connected and bus.publish({"k": b"1"}))


def test_a_server_that_loads_is_no_refusal_of_the_replication_stream(tmp_path: Path) -> None:
    with answering(tmp_path / "bus.sock", {b"PSYNC": b"-LOADING it is loading\r\n"}) as address:
        with pytest.raises(BusError, match="no replication stream yet: LOADING") as refusal:
            open_tap(address)
        assert not isinstance(refusal.value, TapRefused)


def test_a_server_that_loads_is_named_in_one_line(tmp_path: Path) -> None:
    with (
        answering(tmp_path / "bus.sock", {b"SELECT": b"-LOADING it is loading\r\n"}) as address,
        pytest.raises(BusError, match="LOADING it is loading"),
    ):
        Bus(address, name="g1")


def test_a_subscription_that_is_refused_leaves_no_watch_that_hears_nothing(tmp_path: Path) -> None:
    answers = {b"SUBSCRIBE": b"-NOPERM not for you\r\n", b"CONFIG": b"*2\r\n$1\r\nx\r\n$4\r\nK$gx\r\n"}
    with answering(tmp_path / "bus.sock", answers) as address, Watch(address, ["k"]) as watch:
        assert not watch.is_connected
        wait_until(lambda: "refuses subscriptions: NOPERM" in watch._last_error)


def test_a_subscription_that_is_not_answered_is_tried_again(tmp_path: Path) -> None:
    answers = {b"SUBSCRIBE": b"", b"CONFIG": b"*2\r\n$1\r\nx\r\n$4\r\nK$gx\r\n"}
    with answering(tmp_path / "bus.sock", answers) as address, Watch(address, ["k"]) as watch:
        wait_until(lambda: "no answer to a subscription" in watch._last_error)
        answers |= {b"SUBSCRIBE": b":1\r\n:1\r\n", b"MGET": b"*2\r\n$-1\r\n$-1\r\n"}
        wait_until(lambda: watch.is_connected)


def test_a_half_open_connection_is_given_up_and_another_is_made(
    bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "_STALL_S", 0.6)
    with Proxy(bus_server) as network, Bus(network.address, name="g1") as bus, bus.watch(["k"]) as watch:
        bus.publish({"k": b"1"})
        wait_until(lambda: watch.latest("k") is not None)
        network.swallow()
        while bus.connections == 1:
            bus.publish({"k": b"2"})
            time.sleep(0.005)  # as a writer does: one that never waits leaves the threads that reconnect no time
        wait_until(lambda: watch.connections == 2)
        assert bus.publish({"k": b"3"})
        wait_until(lambda: (found := watch.latest("k")) is not None and found.value == b"3")
        assert [found.kind for found in bus.outages.pop() if found.kind != "bus-silent"] == ["bus-back"]


def test_a_lossless_tap_is_lost_with_a_half_open_connection_and_goes_on_where_it_was(bus_server: BusAddress) -> None:
    with Proxy(bus_server) as network, Bus(bus_server, name="g1", timeout_s=5.0) as bus:
        tap = ReplicationTap(network.address)
        tap._link.silence_limit_s = 2.5  # in place of 5: it asks the server how often that speaks up, and that is 1 s
        network.swallow()
        bus.publish({"k": b"1"})
        with pytest.raises(BusError, match=r"silent for \d+ s"):  # noqa: PT012
            while True:
                assert tap.read(1.0) == []
        tap.close()
        again = open_tap(network.address, resume=tap.position(), backend="replication")
        assert again.resumed
        assert [write.value for write in again.read(1.0) if write.key == "k"] == [b"1"]
        again.close()


def test_a_connection_over_a_network_is_kept_alive_by_the_kernel(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = found.getsockname()[1]
    with RedisServer.start(ServerOptions(socket=None, tcp_port=port, folder=tmp_path)) as server:
        connection = Connection(server.address, timeout_s=5.0)
        with socket.socket(fileno=os.dup(connection.fileno())) as stream:
            assert stream.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        connection.close()


def test_a_watch_that_fell_silent_together_with_the_bus_is_not_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = 1_000
    found = Outages(cast(Clock, SimpleNamespace(monotonic_ns=lambda: now_ns)))
    found.record("watch-back", 0)
    found.record("bus-silent", 0)
    found.record("watch-back", 0)
    assert [one.kind for one in found.pop()] == ["bus-silent"]
    now_ns = 2_000
    found.record("watch-back", 0)
    assert found.pop() == [], "nor when it came back later than the bus was told of"
    now_ns = 3_000
    found.record("watch-back", 2_900)
    now_ns = 4_000
    found.record("watch-back", 2_000)
    assert [one.kind for one in found.pop()] == ["watch-back"], "two watches of one process"


def test_it_waits_until_a_recorder_hears_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outage, "_SETTLE_NS", 10**15)
    found = Outages()
    found.record("bus-back", time.monotonic_ns())
    assert found.pop() == []
    monkeypatch.setattr(outage, "_SETTLE_NS", 0)
    assert len(found.pop()) == 1
    assert found.pop() == []


def test_a_process_that_nobody_asks_remembers_no_more_than_a_hundred() -> None:
    found = Outages()
    for _ in range(1000):
        found.record("bus-back", 0)
    assert len(found.pop()) == 100
    assert Outage("bus-back", 0, 10**9, {"x": 1}).detail(2 * 10**9).keys() == {"seconds", "began_ago_s", "x"}
