"""What the network in virtual time does to the station's own clients: latency, lines that freeze, a bus that dies."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from station.bus.client import Bus
from station.bus.connection import Connection, ConnectionLost
from station.errors import BusError
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network

MS = 1_000_000


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    """Virtual time."""
    with VirtualClock() as made:
        yield made


def test_a_round_trip_takes_twice_the_latency(clock: VirtualClock) -> None:
    line = Connection(Network(clock, latency_ns=(3 * MS, 3 * MS)).address(), timeout_s=1.0)
    began_ns = clock.monotonic_ns()
    assert line.call("PING") == b"PONG"
    assert clock.monotonic_ns() - began_ns == 6 * MS


def test_what_a_frozen_line_held_passes_at_once_and_in_order(clock: VirtualClock) -> None:
    network = Network(clock, latency_ns=(1 * MS, 2 * MS))
    with Bus(network.address(), name="motion") as bus:
        network.freeze(clock.process, 1.0)
        for number in range(5):
            bus.publish({"key": b"%d" % number})
            clock.sleep(0.1)
        assert not network.server.journal
        assert bus.is_late
        clock.sleep(1.0)
        instants = {at_ns for at_ns, key, _ in network.server.journal if key == b"key"}
        assert [value for _, key, value in network.server.journal if key == b"key"] == [b"0", b"1", b"2", b"3", b"4"]
        assert len(instants) == 1
        assert bus.catch_up()


def test_a_line_that_is_cut_is_opened_again(clock: VirtualClock) -> None:
    network = Network(clock, latency_ns=(1 * MS, 2 * MS))
    with Bus(network.address(), name="motion") as bus:
        network.cut(clock.process)
        assert not bus.publish({"key": b"1"})
        clock.sleep(0.1)
        assert bus.publish({"key": b"2"})
        assert (bus.connections, bus.lost_writes) == (2, 1)


def test_a_bus_that_is_started_again_has_forgotten_all(clock: VirtualClock) -> None:
    network = Network(clock)
    with Bus(network.address(), name="motion") as bus:
        bus.publish({"key": b"1"})
        network.restart_server(0.5)
        assert not bus.publish({"key": b"2"})
        with pytest.raises(BusError, match="Connection refused"):
            Connection(network.address())
        clock.sleep(0.6)
        assert bus.get("key") is None
        assert bus.publish({"key": b"3"})


def test_a_frozen_bus_answers_late(clock: VirtualClock) -> None:
    network = Network(clock)
    line = Connection(network.address(), timeout_s=0.2)
    network.freeze_server(0.3)
    with pytest.raises(ConnectionLost, match="no answer in time"):
        line.call("PING")
    clock.sleep(0.2)
    assert Connection(network.address()).call("PING") == b"PONG"


def test_bytes_in_pieces_are_put_together(clock: VirtualClock) -> None:
    network = Network(clock)
    network.link(clock.process).fragments = True
    line = Connection(network.address(), timeout_s=1.0)
    assert line.call("SET", "key", b"x" * 5000) == b"OK"
    assert line.call("GET", "key") == b"x" * 5000


def test_the_lines_of_a_process_that_is_killed_are_closed_by_the_kernel(clock: VirtualClock) -> None:
    network = Network(clock)

    def run() -> None:
        with Bus(network.address(), name="motion") as bus:
            while True:
                bus.publish({"key": b"1"})
                clock.sleep(0.02)

    process = clock.spawn(run, "motion")
    clock.sleep(0.1)
    assert len(network.server.clients) == 1
    clock.kill(process)
    clock.sleep(0.1)
    assert not network.server.clients


def test_who_writes_while_nobody_reads_is_held_up_and_loses_nothing(clock: VirtualClock) -> None:
    network = Network(clock)
    with Bus(network.address(), name="camera") as bus:
        network.freeze_server(1.0)
        for number in range(20):
            assert bus.publish({"picture": b"%05d" % number * 10_000})
        clock.sleep(1.1)
        assert bus.catch_up()
        written = [value[:5] for _, key, value in network.server.journal if key == b"picture" and value]
        assert written == [b"%05d" % number for number in range(20)]
