"""How long a client of the bus waits for a server that is frozen, gone, or has nothing to say."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from station.bus import client, redis_server
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import BACKENDS, Tap, open_tap
from station.bus.tap.replication import ReplicationTap
from station.errors import BusError
from tests.bus.proxy import Proxy
from tests.bus.tap.traffic import read_until_lost
from tests.faults.bus_station import frozen, pid_of
from tests.figures import Figures


@pytest.fixture
def server(processes: None, tmp_path: Path) -> Iterator[RedisServer]:
    with RedisServer.start(ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")) as made:
        yield made


def seconds(work: Callable[[], object]) -> float:
    """Return how long something takes [s]."""
    began_s = time.monotonic()
    work()
    return time.monotonic() - began_s


def test_a_frozen_server_holds_a_writer_no_longer_than_its_time_out(bus_server: BusAddress, proof: Figures) -> None:
    with Bus(bus_server, name="motion") as bus, frozen(pid_of(bus_server)):
        held_s = seconds(lambda: [bus.publish({"k": b"1"}) for _ in range(100)])
    assert held_s < 0.5, "one late answer must not be waited for again and again"
    proof.figure("100 writes to a frozen bus", held_s * 1e3, "ms", limit="500 ms")


def test_closing_a_watch_waits_for_nothing(bus_server: BusAddress, proof: Figures) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus:
        closed_s = seconds(lambda: [bus.watch(["k"]).close() for _ in range(20)])
    assert closed_s < 5.0, "one that sits out its wait of a second takes 20"
    proof.figure("opening and closing 20 watches of a bus", closed_s, "s", limit="5 s")


def test_a_server_stops_without_waiting_for_a_tap_that_lags(server: RedisServer, proof: Figures) -> None:
    tap, line = open_tap(server.address), Connection(server.address, timeout_s=5.0)
    line.call("SET", "a", "1")  # never read, so never acknowledged
    line.close()
    stopped_s = seconds(server.stop)
    tap.close()
    assert stopped_s < redis_server._STOP_TIMEOUT_S
    proof.figure("stop of a bus with a tap that lags", stopped_s, "s", limit=f"{redis_server._STOP_TIMEOUT_S:g} s")


@pytest.mark.parametrize("backend", [None, *BACKENDS])
def test_a_missing_server_is_told_at_once(tmp_path: Path, backend: str | None, proof: Figures) -> None:
    began_s = time.monotonic()
    with pytest.raises(BusError, match="No such file"):
        open_tap(BusAddress(socket=str(tmp_path / "none.sock")), backend=backend)
    assert time.monotonic() - began_s < 1.0


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_tap_waits_no_longer_than_it_is_told(bus_server: BusAddress, backend: str, proof: Figures) -> None:
    tap: Tap = open_tap(bus_server, backend=backend)
    while tap.read(0.05):
        pass  # what opening it has written
    waited_s = seconds(lambda: tap.read(0.2))
    tap.close()
    assert 0.2 <= waited_s < 0.5
    proof.figure(f"a wait of 200 ms of the tap by {backend}", waited_s * 1e3, "ms", limit="500 ms")


def test_a_frozen_server_is_told_by_the_tap(server: RedisServer, proof: Figures) -> None:
    tap = ReplicationTap(server.address)
    os.kill(server.pid, signal.SIGSTOP)
    began_s = time.monotonic()
    with pytest.raises(BusError, match="silent"):
        read_until_lost(tap)
    told_s = time.monotonic() - began_s
    os.kill(server.pid, signal.SIGCONT)
    tap.close()
    assert told_s < 10.0
    proof.figure("a frozen bus to a recorder's tap that is given up", told_s, "s", limit="10 s")


def test_no_write_waits_for_a_network_that_is_silent(
    bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch, proof: Figures
) -> None:
    monkeypatch.setattr(client, "_STALL_S", 0.6)
    longest_s = 0.0
    with Proxy(bus_server) as network, Bus(network.address, name="g1") as bus:
        bus.publish({"k": b"1"})
        network.swallow()
        while bus.connections == 1:
            longest_s = max(longest_s, seconds(lambda: bus.publish({"k": b"2"})))
    assert longest_s < 0.5
    proof.figure("longest write over a half-open connection", longest_s * 1e3, "ms", limit="500 ms")
