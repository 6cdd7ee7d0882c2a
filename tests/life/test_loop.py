"""Fixed rates: deadlines that do not drift, missed periods counted and not made up for."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from station.clock import SYSTEM
from station.life.loop import Rate
from tests.virtual.clock import VirtualClock

MS = 1_000_000


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    """Virtual time."""
    with VirtualClock() as made:
        yield made


def test_deadlines_stay_a_period_apart_however_late_a_tick_wakes() -> None:
    with VirtualClock(late_ns=9 * MS) as clock:
        rate, wakes = Rate(100.0, clock), []
        for _ in range(20):
            rate.wait()
            wakes.append(clock.monotonic_ns())
    late_ns = [wake - wakes[0] - tick * rate.period_ns for tick, wake in enumerate(wakes)]
    assert rate.overruns == 0
    assert all(0 <= late < 9 * MS for late in late_ns), "a late tick must not shift the ones after it"
    assert max(late_ns) > 5 * MS


def test_missed_periods_are_counted_and_skipped(clock: VirtualClock) -> None:
    rate = Rate(100.0, clock)
    rate.wait()
    began_ns = clock.monotonic_ns()
    clock.sleep(0.055)
    rate.wait()
    assert (clock.monotonic_ns() - began_ns, rate.overruns) == (55 * MS, 4), "the next tick is the newest that is due"
    rate.wait()
    assert clock.monotonic_ns() - began_ns == 60 * MS
    assert rate.stats().overruns == 4


def test_stats_tell_rate_and_lateness() -> None:
    with VirtualClock(late_ns=2 * MS) as clock:
        rate = Rate(200.0, clock)
        assert rate.stats().rate_hz == 0.0
        for _ in range(50):
            rate.wait()
        stats = rate.stats()
    assert 0.0 < stats.jitter_p50_ms < stats.jitter_p99_ms < 2.0
    assert stats.rate_hz == pytest.approx(200.0, rel=0.01)


def test_what_is_urgent_does_not_wait_for_its_tick(clock: VirtualClock) -> None:
    rate, urgent = Rate(0.01, clock), threading.Event()
    rate.wait(urgent)
    began_ns = clock.monotonic_ns()
    clock.call_at(began_ns + 50 * MS, urgent.set)
    rate.wait(urgent)
    assert clock.monotonic_ns() - began_ns == 50 * MS
    assert rate.overruns == 0


def test_later_deadlines_count_from_the_tick_that_came_early(clock: VirtualClock) -> None:
    rate, urgent = Rate(1.0, clock), threading.Event()
    rate.wait(urgent)
    began_ns = clock.monotonic_ns()
    clock.call_at(began_ns + 300 * MS, urgent.set)
    rate.wait(urgent)
    rate.wait()
    assert clock.monotonic_ns() - began_ns == 300 * MS + rate.period_ns


def test_who_is_urgent_all_the_time_cannot_make_the_loop_run_away(clock: VirtualClock) -> None:
    rate, urgent = Rate(0.01, clock), threading.Event()
    began_ns = clock.monotonic_ns()
    urgent.set()
    for _ in range(10):
        rate.wait(urgent)
    assert clock.monotonic_ns() - began_ns == 5 * rate.period_ns, "every other tick waits for its deadline"


def test_a_loop_keeps_its_rate_by_the_machines_clock() -> None:
    began_ns = SYSTEM.monotonic_ns()
    rate, urgent = Rate(200.0), threading.Event()
    for _ in range(5):
        rate.wait(urgent)
    assert SYSTEM.monotonic_ns() - began_ns >= 4 * rate.period_ns
