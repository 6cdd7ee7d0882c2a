"""What a control step gets of the writes of a key, on a real server."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import pytest

from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.control.command_arbiter import CommandArbiter, Rule
from station.control.command_receiver import CommandReceiver, CommandWatch
from tests.waiting import wait_until

KEY = "command"
SILENT_AFTER_S = 1.0  # more than a writer here is held up on a busy machine
LONGER_S = 1.2 * SILENT_AFTER_S


@pytest.fixture
def watch(bus_server: BusAddress) -> Iterator[CommandWatch]:
    with CommandWatch(bus_server, [KEY], key=KEY) as found:
        wait_until(lambda: found.is_connected)
        yield found


@pytest.fixture
def line(bus_server: BusAddress) -> Iterator[Connection]:
    connection = Connection(bus_server, timeout_s=5.0)
    yield connection
    connection.close()


def write_both_at_once(line: Connection, seq: int = 1) -> None:
    """A foreign write and a native one, with nothing in between: who wrote the value that is found cannot be told."""
    mark = stamp.Stamp(seq, 1, 1, "teleop.1.b.n").encode()
    line.pipeline([["MULTI"], ["SET", KEY, b"foreign"], ["MSET", KEY, b"native", keys.stamp(KEY), mark], ["EXEC"]])


def test_a_write_whose_writer_cannot_be_told_is_left_out_and_counts_as_refused(
    watch: CommandWatch, line: Connection
) -> None:
    receiver = CommandReceiver(watch, KEY, CommandArbiter())
    for count in (1, 2):
        write_both_at_once(line)
        wait_until(lambda count=count: watch.doubtful == count)  # type: ignore[misc]
        assert receiver.newest() is None
        assert receiver.pop_refused() == 1, "something came, and be it nobody's"
        assert receiver.pop_refused() == 0
        assert receiver.writers.refusal == "two write, and which of them wrote it cannot be told"
    line.call("SET", KEY, b"foreign")
    wait_until(lambda: (command := receiver.newest()) is not None and command.value == b"foreign")
    assert receiver.pop_refused() == 0


def write(line: Connection, name: str, seq: int) -> None:
    """A native write."""
    line.call(*native(name, seq))


def native(name: str, seq: int) -> list[str | bytes]:
    return ["MSET", KEY, f"{name} {seq}", keys.stamp(KEY), stamp.Stamp(seq, 1, 1, f"{name}.1.b.n").encode()]


def wait_for(watch: CommandWatch, value: str) -> None:
    wait_until(lambda: (found := watch.latest(KEY)) is not None and found.value == value.encode())


def wait_until_heard(watch: CommandWatch, since_ns: int) -> None:
    wait_until(lambda: watch.heard.until_ns > since_ns)


@pytest.mark.parametrize("rule", ["keep-first", "newest"])
def test_a_loop_that_stood_still_hands_over_between_no_two_who_wrote_all_the_time(
    watch: CommandWatch, line: Connection, rule: Rule
) -> None:
    receiver = CommandReceiver(watch, KEY, CommandArbiter(rule, SILENT_AFTER_S))
    obeyed = {"keep-first": "a", "newest": "b"}[rule]
    for name in "ab":
        write(line, name, 1)
        wait_for(watch, f"{name} 1")
        receiver.newest()
    assert receiver.writers.obeyed == f"{obeyed}.1.b.n"
    began_ns, seq = time.monotonic_ns(), 1
    while time.monotonic_ns() - began_ns < LONGER_S * 1e9:  # the loop looks at nothing
        seq += 1
        for name in "ba" if rule == "keep-first" else "ab":
            write(line, name, seq)
            wait_for(watch, f"{name} {seq}")
    wait_until_heard(watch, time.monotonic_ns())
    command = receiver.newest()
    assert receiver.writers.obeyed == f"{obeyed}.1.b.n"
    assert command is not None
    assert command.value == f"{obeyed} {seq}".encode()
    assert receiver.pop_refused() == seq - (rule == "newest")


def test_of_more_writes_than_it_can_keep_nothing_is_known(
    watch: CommandWatch, line: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("station.control.command_receiver._MOST_WRITES", 4)
    for seq in range(1, 6):
        before_ns = time.monotonic_ns()
        write(line, "a", seq)
        wait_for(watch, f"a {seq}")
    taken = watch.pop()
    assert [arrival.writer for arrival in taken.arrivals] == ["a.1.b.n"]
    assert taken.heard.since_ns > before_ns


@pytest.mark.parametrize("first", ["ours", "foreign"])
def test_who_is_obeyed_lives_though_of_none_of_his_writes_it_can_be_told_whether_it_is_his(
    watch: CommandWatch, line: Connection, first: str
) -> None:
    receiver = CommandReceiver(watch, KEY, CommandArbiter(silent_after_s=SILENT_AFTER_S))
    writes = [lambda: write(line, "teleop", 1), lambda: line.call("SET", KEY, b"foreign")]
    if first == "foreign":
        writes.reverse()
    writes[0]()
    wait_until(lambda: receiver.newest() is not None)
    obeyed, began_ns, count = receiver.writers.obeyed, time.monotonic_ns(), 0
    while watch.heard.until_ns - began_ns < LONGER_S * 1e9:
        count += 1
        write_both_at_once(line, count + 1)
        wait_until(lambda count=count: watch.doubtful == count)  # type: ignore[misc]
        receiver.newest()
    before = watch.latest(KEY)
    writes[1]()
    wait_until(lambda: watch.latest(KEY) is not before)
    receiver.newest()
    assert receiver.writers.obeyed == obeyed


def test_who_is_overwritten_each_time_before_he_can_be_read_is_not_silent(
    watch: CommandWatch, line: Connection
) -> None:
    """Two commanders answer to the same state, the second always at once after the first."""
    receiver = CommandReceiver(watch, KEY, CommandArbiter(silent_after_s=SILENT_AFTER_S))
    write(line, "a", 1)
    wait_until(lambda: receiver.newest() is not None)
    began_ns, seq = time.monotonic_ns(), 1
    while watch.heard.until_ns - began_ns < LONGER_S * 1e9:
        seq += 1
        line.pipeline([native("a", seq), native("b", seq)])
        wait_for(watch, f"b {seq}")
        receiver.newest()
    assert receiver.writers.obeyed == "a.1.b.n"

    def is_handed_over() -> bool:
        nonlocal seq
        seq += 1
        line.pipeline([native("b", seq)] if seq % 2 else [native("b", seq), native("b", seq := seq + 1)])
        wait_for(watch, f"b {seq}")
        receiver.newest()
        return receiver.writers.obeyed == "b.1.b.n"

    wait_until(is_handed_over)  # the first is silent; b's numbers account for all that is told of


def test_what_it_knows_of_is_as_old_as_its_last_look_on_the_clock_of_the_gate(watch: CommandWatch) -> None:
    receiver = CommandReceiver(watch, KEY, CommandArbiter())
    assert receiver.heard_s == (-math.inf, -math.inf)
    began_s = time.monotonic()
    wait_until(lambda: receiver.newest() is None and receiver.heard_s[0] < receiver.heard_s[1] > began_s)
    assert receiver.heard_s[1] < time.monotonic()
    wait_until(lambda: receiver.newest(7.0) is None and receiver.heard_s[0] < receiver.heard_s[1] < 7.0)
    wait_until(lambda: receiver.newest(7.0) is None and receiver.heard_s[1] > 6.0)
