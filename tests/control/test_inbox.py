"""What a control step gets of the writes of a key, on a real server."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import pytest

from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.control.inbox import CommandWatch, Inbox
from station.control.writers import Writers
from tests.waiting import wait_until

KEY = "command"


@pytest.fixture
def watch(bus_server: BusAddress) -> Iterator[CommandWatch]:
    with CommandWatch(bus_server, [KEY], key=KEY) as found:
        yield found


@pytest.fixture
def line(bus_server: BusAddress) -> Iterator[Connection]:
    connection = Connection(bus_server, timeout_s=5.0)
    yield connection
    connection.close()


def write_both_at_once(line: Connection) -> None:
    """A foreign write and a native one, with nothing in between: who wrote the value that is found cannot be told."""
    mark = stamp.Stamp(1, 1, 1, "teleop.1.b.n").encode()
    line.pipeline([["MULTI"], ["SET", KEY, b"foreign"], ["MSET", KEY, b"native", keys.stamp(KEY), mark], ["EXEC"]])


def test_a_write_whose_writer_cannot_be_told_is_left_out_and_counts_as_refused(
    watch: CommandWatch, line: Connection
) -> None:
    inbox = Inbox(watch, KEY, Writers())
    for count in (1, 2):
        write_both_at_once(line)
        wait_until(lambda count=count: watch.doubtful == count)  # type: ignore[misc]
        assert inbox.newest() is None
        assert inbox.take_refused() == 1, "something came, and be it nobody's"
        assert inbox.take_refused() == 0
        assert inbox.writers.refusal == "two write, and which of them wrote it cannot be told"
    line.call("SET", KEY, b"foreign")
    wait_until(lambda: (command := inbox.newest()) is not None and command.value == b"foreign")
    assert inbox.take_refused() == 0


def test_what_it_knows_of_is_as_old_as_its_last_look_on_the_clock_of_the_gate(watch: CommandWatch) -> None:
    inbox = Inbox(watch, KEY, Writers())
    assert inbox.heard_s == (-math.inf, -math.inf)
    wait_until(lambda: watch.heard.until_ns > watch.heard.since_ns)
    began_s = time.monotonic()
    inbox.newest()
    assert inbox.heard_s[0] < inbox.heard_s[1] < time.monotonic()
    wait_until(lambda: inbox.newest() is None and inbox.heard_s[1] > began_s)
    wait_until(lambda: inbox.newest(7.0) is None and 6.0 < inbox.heard_s[1] < 7.0)
    assert inbox.heard_s[0] < inbox.heard_s[1]
