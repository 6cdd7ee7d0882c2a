"""Fixed rates: deadlines that do not drift, missed periods counted and not made up for."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator

import numpy as np
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
        wakes_ns = []
        for _ in range(50):
            rate.wait()
            wakes_ns.append(clock.monotonic_ns())
        stats = rate.stats()
    late_ms = (np.array(wakes_ns) - wakes_ns[0] - np.arange(50) * rate.period_ns) * 1e-6
    p50, p99 = np.percentile(late_ms, (50, 99))
    assert 0.0 < p50 < p99 < 2.0
    assert (stats.jitter_p50_ms, stats.jitter_p99_ms) == pytest.approx((p50, p99))
    assert stats.rate_hz == pytest.approx(200.0, rel=0.01)


@pytest.mark.usefixtures("processes")
def test_no_tick_waits_for_a_library_that_its_statistics_load() -> None:
    code = (
        "import sys; from station.life.loop import Rate; import station.protocols; rate = Rate(500.0); rate.wait();"
        "before = set(sys.modules); rate.wait(); rate.stats(); print(*(set(sys.modules) - before))"
    )
    run = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


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
