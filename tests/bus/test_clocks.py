"""What a machine knows of the bus server's clock, and of another machine's: never wrong by more than it says."""

from __future__ import annotations

import random
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.bus import codec, keys, stamp
from station.bus.address import BusAddress, parse
from station.bus.client import Bus
from station.bus.clocks import (
    KEPT,
    MOST_ERROR_NS,
    BusTime,
    ClockStatement,
    Offset,
    decode_statement,
    kernel_says,
    offset_of,
)
from tests.examples import examples
from tests.waiting import DEADLINE_S, wait_until

MS, S = 1_000_000, 1_000_000_000
EPOCH_NS = 1_700_000_000 * S

_delays_ns = st.integers(0, 200 * MS)
_lines = st.lists(st.tuples(_delays_ns, _delays_ns), min_size=1, max_size=60)


class Machine:
    """A computer whose quartz runs at a rate of its own, beside a bus; true time is the bus's."""

    def __init__(self, begun_ns: int, drift: float = 0.0) -> None:
        self.begun_ns, self.drift, self.time = begun_ns, drift, BusTime()

    def mono_ns(self, true_ns: int) -> int:
        return self.begun_ns + int(true_ns * (1.0 + self.drift))

    def compare(self, true_ns: int, there_ns: int, back_ns: int, leap_ns: int = 0) -> bool:
        bus_ns = (EPOCH_NS + true_ns + there_ns + leap_ns) // 1_000 * 1_000  # microseconds
        return self.time.add(self.mono_ns(true_ns), bus_ns, self.mono_ns(true_ns + there_ns + back_ns))

    def best(self, true_ns: int) -> Offset:
        found = self.time.best(self.mono_ns(true_ns))
        assert found is not None
        return found

    def says(self, true_ns: int) -> ClockStatement:
        best, mono_ns = self.best(true_ns), self.mono_ns(true_ns)
        return ClockStatement(
            boot="b", host="h", mono_ns=mono_ns, wall_ns=0, bus_ns=mono_ns + best.ns, error_ns=best.error_ns,
            since_bus_ns=self.time.since_bus_ns, round_trip_ns=0, comparisons=len(self.time),
        )  # fmt: skip


@settings(max_examples=examples(300), deadline=None)
@given(_lines, st.integers(0, 10**15), st.floats(-5e-5, 5e-5))
def test_whatever_the_line_does_the_offset_is_never_wrong_by_more_than_its_error(
    line: list[tuple[int, int]], begun_ns: int, drift: float
) -> None:
    machine, true_ns = Machine(begun_ns, drift), 0
    for there_ns, back_ns in line:
        assert not machine.compare(true_ns, there_ns, back_ns), "no line makes a clock leap"
        true_ns += there_ns + back_ns + 100 * MS
        best = machine.best(true_ns)
        assert abs(machine.mono_ns(true_ns) + best.ns - (EPOCH_NS + true_ns)) <= best.error_ns


@settings(max_examples=examples(300), deadline=None)
@given(_lines, _lines, st.integers(0, 10**15), st.floats(-5e-5, 5e-5), st.integers(0, 60 * S))
def test_two_machines_know_each_others_clock_to_within_the_error(
    ours: list[tuple[int, int]], theirs: list[tuple[int, int]], begun_ns: int, drift: float, later_ns: int
) -> None:
    here, there = Machine(5 * S), Machine(begun_ns, drift)
    for machine, line in ((here, ours), (there, theirs)):
        for number, (there_ns, back_ns) in enumerate(line):
            machine.compare(number * 500 * MS, there_ns, back_ns)
    said, now_ns = there.says(60 * 500 * MS), 60 * 500 * MS + later_ns
    found = offset_of(said, here.best(now_ns), here.time.since_bus_ns, here.mono_ns(now_ns))
    if found is None:
        assert here.best(now_ns).error_ns + said.error_ns + later_ns // 9_000 > MOST_ERROR_NS
    else:
        assert found.error_ns <= MOST_ERROR_NS
        assert abs(there.mono_ns(now_ns) + found.ns - here.mono_ns(now_ns)) <= found.error_ns


def test_the_best_of_many_comparisons_counts_on_a_line_of_5_ms_and_10_of_jitter() -> None:
    chance, worst = random.Random(3), 0
    machine = Machine(9 * S)
    for number in range(600):
        there_ns, back_ns = (int(max(0.0, chance.gauss(5.0, 10.0)) * MS) for _ in range(2))
        machine.compare(number * 100 * MS, there_ns, back_ns)
        if number >= KEPT:
            true_ns = number * 100 * MS + there_ns + back_ns
            worst = max(worst, abs(machine.mono_ns(true_ns) + machine.best(true_ns).ns - EPOCH_NS - true_ns))
    assert worst < 5 * MS


@pytest.mark.parametrize("leap_ns", [-3600 * S, -S, 50 * MS, S, 3600 * S])
def test_a_leap_of_the_bus_servers_clock_is_seen_and_nothing_of_before_it_counts(leap_ns: int) -> None:
    machine = Machine(0)
    for number in range(20):
        machine.compare(number * 100 * MS, 5 * MS, 6 * MS)
    assert machine.compare(20 * 100 * MS, 5 * MS, 6 * MS, leap_ns)
    best = machine.best(2 * S)
    assert abs(best.ns - EPOCH_NS - leap_ns) <= best.error_ns
    assert machine.time.since_bus_ns > EPOCH_NS + leap_ns


@pytest.mark.parametrize("leap_ns", [-3600 * S, 3600 * S])
def test_what_a_machine_said_before_a_leap_says_nothing_after_it(leap_ns: int) -> None:
    here, there = Machine(0), Machine(77 * S)
    for machine in (here, there):
        machine.compare(0, MS, MS)
    before = there.says(0)
    assert offset_of(before, here.best(0), here.time.since_bus_ns, here.mono_ns(0)) is not None
    here.compare(S, MS, MS, leap_ns)
    assert offset_of(before, here.best(S), here.time.since_bus_ns, here.mono_ns(S)) is None
    there.compare(S, MS, MS, leap_ns)
    assert offset_of(there.says(S), here.best(S), here.time.since_bus_ns, here.mono_ns(S)) is not None


def test_a_clock_that_leapt_forward_where_only_the_other_machine_has_seen_it_is_not_known() -> None:
    here, there = Machine(0), Machine(77 * S)
    here.compare(0, MS, MS)
    there.compare(S, MS, MS, 10 * S)
    assert offset_of(there.says(S), here.best(S), here.time.since_bus_ns, here.mono_ns(S)) is None


@pytest.mark.parametrize("data", [b"", b"{}", b"[1]", b"\xff", b'{"boot": "other"}', None])
def test_what_is_no_statement_of_that_machine_says_nothing(data: bytes | None) -> None:
    assert decode_statement(data, "b") is None
    said = _statement()
    assert decode_statement(codec.json_object(said), "b") == said
    assert decode_statement(codec.json_object(said), "c") is None


def _statement() -> ClockStatement:
    machine = Machine(3 * S)
    machine.compare(0, MS, MS)
    return machine.says(0)


@pytest.mark.parametrize(("url", "is_local"), [
    ("unix:///run/bus.sock", True), ("redis://localhost:6379/0", True), ("redis://127.0.0.1", True),
    ("redis://[::1]:6379/0", True), ("redis://192.168.123.164", False), ("rediss://robot.lab:6379", False),
    ("redis://127.lab.example", False), ("redis://[::1234]:6379/0", False),
])  # fmt: skip
def test_whether_a_bus_is_on_this_machine(url: str, is_local: bool) -> None:
    assert parse(url).is_local == is_local


def test_the_kernel_says_whether_the_wall_clock_is_kept_right() -> None:
    is_synchronised, error_ns = kernel_says()
    assert (is_synchronised is True) == (error_ns is not None)


def test_a_machine_says_what_its_clock_is_beside_a_real_servers(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="one") as bus:
        assert bus.read([keys.clock(stamp.boot_id())]) == {}, "nobody asked"
        bus.clocks.publish = bus.publish
        bus.clocks.start()
        deadline_s = time.monotonic() + 10.0
        while (said := decode_statement(bus.get(keys.clock(stamp.boot_id())), stamp.boot_id())) is None:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
    assert abs(said.to_bus - (time.time_ns() - time.monotonic_ns())) <= said.error_ns + MS
    assert abs(said.wall_ns - said.bus_ns) <= said.error_ns + MS, "one machine, one wall clock"


@pytest.mark.parametrize(("off_ns", "error_ns", "is_followed"), [
    (20 * MS, 30 * MS, False),  # of a process that has just begun to measure
    (5 * S, 30 * MS, True),  # its clock stood still: the computer slept
    (0, -MS, False),
])  # fmt: skip
def test_of_two_statements_of_a_machine_the_better_one_counts_unless_they_contradict_each_other(
    bus_server: BusAddress, off_ns: int, error_ns: int, is_followed: bool
) -> None:
    with Bus(bus_server, name="one") as bus:

        def say(said_ns: int, said_error_ns: int) -> None:
            now_ns = time.time_ns()
            bus.publish({keys.clock("aaaaaaaa"): codec.json_object(ClockStatement(
                boot="aaaaaaaa", host="other", mono_ns=time.monotonic_ns() - said_ns, wall_ns=now_ns, bus_ns=now_ns,
                error_ns=said_error_ns, since_bus_ns=0, round_trip_ns=0, comparisons=1,
            ))})  # fmt: skip

        def known() -> Offset | None:
            """Say the first until it is known, since what was said before a comparison of ours says nothing; then the
            second, and return what is known then."""
            while bus.clocks.offset_of("aaaaaaaa") is None:
                say(0, MS)
                time.sleep(0.1)
            say(off_ns, error_ns)
            time.sleep(1.5)
            return bus.clocks.offset_of("aaaaaaaa")

        found: list[Offset] = []

        def is_settled() -> bool:
            if (offset := known()) is None or (is_followed and abs(offset.ns) <= 5 * MS):
                return False
            found.append(offset)
            return True

        wait_until(is_settled)
    assert (abs(found[0].ns) > 5 * MS, found[0].error_ns > 5 * MS) == (is_followed, is_followed)


def test_another_machines_clock_is_asked_for_once_it_writes(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="one") as bus:
        assert bus.clocks.offset_of("aaaaaaaa") is None
        there = Machine(time.monotonic_ns() + 500 * S)
        theirs = ClockStatement(
            boot="aaaaaaaa", host="other", mono_ns=there.begun_ns, wall_ns=time.time_ns(), bus_ns=time.time_ns(),
            error_ns=MS, since_bus_ns=0, round_trip_ns=0, comparisons=1,
        )  # fmt: skip
        deadline_s = time.monotonic() + DEADLINE_S
        while (
            found := bus.clocks.offset_of("aaaaaaaa")
        ) is None:  # what was said before a comparison of ours says nothing
            bus.publish({keys.clock("aaaaaaaa"): codec.json_object(theirs)})
            assert time.monotonic() < deadline_s
            time.sleep(0.1)
        assert found.ns == pytest.approx(-500 * S, abs=found.error_ns + 20 * MS)
        assert bus.clocks.offset_of("") is None
