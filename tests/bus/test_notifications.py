"""Whether the server tells of every write: somebody may switch that off for all, and it answers as if it were well."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.hearing import HeardSpan
from station.bus.outage import Outages
from station.bus.watch import Watch
from tests.bus.answering import answering
from tests.bus.test_watch import PROBE_S, cuts, wait_until_heard
from tests.waiting import wait_until

SWITCH = ("CONFIG", "SET", "notify-keyspace-events")
OURS = "K$gx"


@pytest.fixture
def line(bus_server: BusAddress) -> Iterator[Connection]:
    connection = Connection(bus_server, timeout_s=5.0)
    yield connection
    connection.close()


def warnings(caplog: pytest.LogCaptureFixture) -> list[logging.LogRecord]:
    return [record for record in caplog.records if record.levelno == logging.WARNING]


@pytest.mark.parametrize("probe_s", [PROBE_S, 1.0])
def test_who_switches_notifications_off_for_all_is_found_and_what_was_not_told_is_taken_up(
    bus_server: BusAddress, line: Connection, probe_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    outages = Outages()
    with Watch(bus_server, ["k"], probe_s=probe_s, outages=outages) as watch:
        wait_until_heard(watch, 0.1)
        line.call(*SWITCH, "Ex")
        off_ns = time.monotonic_ns()
        line.call("SET", "k", b"stop")
        wait_until(lambda: (found := watch.latest("k")) is not None and found.value == b"stop")
        sample = watch.latest("k")
        assert sample is not None
        assert (sample.value, sample.arrived_ns) == (b"stop", None), "of its age nothing is known"
        wait_until(lambda: watch.heard.since_ns > off_ns)
        assert set(line.call("CONFIG", "GET", SWITCH[2])[1].decode()) == set("Ex" + OURS)
        line.call("SET", "k", b"again")
        wait_until(lambda: (found := watch.latest("k")) is not None and found.value == b"again")
        wait_until(lambda: any("notify-keyspace-events" in one.numbers["reason"] for one in outages.pop()))
    (record,) = [record for record in warnings(caplog) if "notify-keyspace-events" in record.message]
    assert "set notify-keyspace-events to 'xE'" in record.message
    assert f"have it keep {OURS}" in record.message


def test_while_nothing_is_told_of_nothing_is_known(bus_server: BusAddress, line: Connection) -> None:
    """A stock script writes the same bytes without end: only the server's setting betrays that it is not heard."""
    with Watch(bus_server, ["k"], probe_s=PROBE_S) as watch:
        line.call("SET", "k", b"same")
        wait_until(lambda: watch.latest("k"))
        wait_until_heard(watch, 0.1)
        for _ in range(3):
            known = watch.connections
            line.pipeline([[*SWITCH, "Ex"], ["SET", "k", b"same"]])
            off_ns = time.monotonic_ns()
            spans: list[HeardSpan] = []
            wait_until(lambda known=known, spans=spans: spans.append(watch.heard) or watch.connections > known)  # type: ignore[misc]
            assert all(span.until_ns < off_ns or span.since_ns > off_ns for span in spans)


def test_a_write_of_a_moment_in_which_notifications_were_off_is_found(bus_server: BusAddress, line: Connection) -> None:
    with Watch(bus_server, ["stop", "command"], probe_s=PROBE_S) as watch:
        wait_until_heard(watch, 0.1)
        off, on = [*SWITCH, "Ex"], [*SWITCH, f"Ex{OURS}"]
        line.pipeline([["SET", "command", b"1"], off, ["SET", "stop", b"now"], on, ["SET", "command", b"2"]])
        wait_until(lambda: (found := watch.latest("stop")) is not None and found.value == b"now")


def test_keys_that_are_written_and_removed_without_end_are_told_of(bus_server: BusAddress, line: Connection) -> None:
    outages = Outages()
    with Watch(bus_server, ["k", "gone", "short"], probe_s=0.001, outages=outages) as watch:
        wait_until(lambda: watch.heard.since_ns > 0)
        for n in range(3000):
            line.pipeline([["SET", "k", b"%d" % n], ["SET", "short", b"%d" % n, "PX", 1], ["SET", "gone", b"1"]])
            line.call("DEL", "gone")
        known_ns = watch.heard.until_ns
        wait_until(lambda: watch.heard.until_ns > known_ns)
        assert cuts(outages) == []


def test_a_user_who_may_not_ask_for_an_answer_watches_all_the_same(bus_server: BusAddress, line: Connection) -> None:
    line.call("ACL", "SETUSER", "plain", "on", ">pw", "~*", "&*", "+@all", "-ping")
    address = BusAddress(socket=bus_server.socket, username="plain", password="pw")
    outages = Outages()
    with Watch(address, ["k"], probe_s=PROBE_S, outages=outages) as watch:
        wait_until_heard(watch, 0.3)
        line.call("SET", "k", b"1")
        wait_until(lambda: watch.latest("k"))
        assert cuts(outages) == []


@pytest.mark.parametrize("answer", [b"-ERR no such thing here\r\n", b"+PONG\r\n"])
def test_any_answer_in_its_order_will_do(tmp_path: Path, answer: bytes) -> None:
    answers = {b"SUBSCRIBE": b":1\r\n:1\r\n", b"MGET": b"*2\r\n$-1\r\n$-1\r\n", b"PING": answer}
    answers[b"CONFIG"] = b"*2\r\n$1\r\nx\r\n$4\r\nK$gx\r\n"
    outages = Outages()
    with (
        answering(tmp_path / "bus.sock", answers) as address,
        Watch(address, ["k"], probe_s=PROBE_S, outages=outages) as watch,
    ):
        wait_until_heard(watch, 0.3)
        assert cuts(outages) == []


def test_a_server_that_cuts_the_line_again_and_again_is_not_rushed_and_is_told_of_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    answers = {b"SUBSCRIBE": b":1\r\n:1\r\n", b"MGET": b"*2\r\n$-1\r\n$-1\r\n", b"PING": b":1\r\n"}
    answers[b"CONFIG"] = b"*2\r\n$1\r\nx\r\n$4\r\nK$gx\r\n"
    began_ns = time.monotonic_ns()
    with answering(tmp_path / "bus.sock", answers) as address, Watch(address, ["k"], probe_s=0.001) as watch:
        wait_until(lambda: watch.connections >= 10)
        assert time.monotonic_ns() - began_ns > 0.3 * 1e9, "a twentieth of a second between two"
    told = [record.message for record in warnings(caplog)]
    assert told
    assert all(one != other for one, other in pairwise(told))
