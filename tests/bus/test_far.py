"""A line to a bus on another machine: no write waits for an answer, and none is lost for want of patience."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from station.bus.client import Bus
from station.bus.outage import Outage
from tests.network_link.far_bus import FarBus, far_bus
from tests.waiting import wait_until

DELAY_S = 0.03
LONGEST_S = 0.02
"""A period of 50 Hz: no write may take longer, on a machine that is not busy."""
CUT_S = 2.0


@pytest.fixture(scope="module")
def cable(network_links: None) -> Iterator[FarBus]:
    with far_bus() as found:
        yield found


@pytest.fixture
def far(cable: FarBus) -> FarBus:
    """A line of 30 ms each way."""
    cable.link.plug()
    cable.link.change(delay_s=DELAY_S)
    return cable


def _write(bus: Bus, count: int, pause_s: float = 0.0) -> float:
    """Write so many times; return the median time that a write took [s]."""
    took_s = []
    for number in range(count):
        began_s = time.monotonic()
        assert bus.publish({"k": b"%d" % number})
        took_s.append(time.monotonic() - began_s)
        time.sleep(pause_s)
    return sorted(took_s)[count // 2]


def _arrived(far: FarBus, value: bytes) -> None:
    with Bus(far.here, name="reader", timeout_s=5.0) as reader:
        wait_until(lambda: reader.get("k") == value)


def test_no_write_waits_for_an_answer_that_takes_longer_than_a_period(far: FarBus) -> None:
    with Bus(far.there, name="motion") as bus:
        assert _write(bus, 100) < LONGEST_S
        _arrived(far, b"99")
        wait_until(bus.catch_up)
        assert (bus.lost_writes, bus.connections, bus.outages.pop()) == (0, 1, [])


def test_a_writer_of_two_a_second_takes_a_far_answer_for_no_silence(far: FarBus) -> None:
    with Bus(far.there, name="motion") as bus:
        _write(bus, 5, pause_s=0.6)
        assert bus.outages.pop() == []


def test_a_request_has_the_patience_of_a_line_that_loses_packets(far: FarBus) -> None:
    far.link.change(delay_s=DELAY_S, jitter_s=0.01, loss=0.02)
    with Bus(far.there, name="motion") as bus:
        for number in range(40):
            assert bus.publish({"k": b"%d" % number})
            assert bus.get("k") == b"%d" % number
        assert bus.connections == 1


def test_who_connects_has_the_patience_of_a_line_that_loses_the_first_packet(far: FarBus) -> None:
    far.link.change(loss=1.0)
    is_good_again = threading.Timer(0.7, far.link.change)
    is_good_again.start()
    with Bus(far.there, name="motion") as bus:
        assert bus.publish({"k": b"here"})
    is_good_again.join()
    _arrived(far, b"here")


def test_a_cut_of_two_seconds_loses_nothing_waits_for_nobody_and_is_told(far: FarBus) -> None:
    with Bus(far.there, name="motion") as bus:
        _write(bus, 5)
        far.link.pull()
        began_s = time.monotonic()
        assert _write(bus, round(CUT_S / 0.02), pause_s=0.02) < LONGEST_S
        far.link.plug()
        wait_until(bus.catch_up)
        assert bus.publish({"k": b"last"})
        _arrived(far, b"last")
        assert (bus.lost_writes, bus.connections) == (0, 1)
        told: list[Outage] = []
        wait_until(lambda: told or told.extend(bus.outages.pop()))
        assert [each.kind for each in told] == ["bus-silent"]
        assert CUT_S * 0.8 < told[0].detail(time.monotonic_ns())["seconds"] < time.monotonic() - began_s


def test_what_is_written_last_arrives_though_it_is_lost_on_the_way_and_its_writer_is_gone(far: FarBus) -> None:
    with Bus(far.there, name="motion") as bus:
        _write(bus, 30)
        far.link.change(loss=1.0, out_of=far.there.end)
        assert bus.publish({"k": b"farewell"})
        is_good_again = threading.Timer(0.3, far.link.change)
        is_good_again.start()
        time.sleep(3 * DELAY_S)  # answers to the others come: a line that is closed with them unread is torn down
    is_good_again.join()
    _arrived(far, b"farewell")


def test_a_reader_has_the_patience_of_a_line_that_loses_packets(far: FarBus) -> None:
    far.link.change(delay_s=DELAY_S, jitter_s=0.01, loss=0.03)
    with Bus(far.here, name="robot", timeout_s=5.0) as robot, Bus(far.there, name="teleop") as bus:
        with bus.watch(["k"]) as watch:
            for number in range(300):
                assert robot.publish({"k": b"%d" % number})
                time.sleep(0.02)
            wait_until(lambda: (newest := watch.latest("k")) is not None and newest.value == b"299")
            assert watch.connections == 1
        assert bus.outages.pop() == []
