"""Fixed rates: deadlines that do not drift, missed periods counted and not made up for."""

from __future__ import annotations

import itertools
import threading
import time

from station.life.loop import Rate, sleep_until


def test_deadlines_stay_a_period_apart_however_late_a_tick_wakes() -> None:
    deadlines: list[int] = []

    def late_sleep(instant_ns: int) -> None:
        deadlines.append(instant_ns)
        sleep_until(instant_ns + 2_000_000)

    rate = Rate(100.0, sleep=late_sleep)
    for _ in range(20):
        rate.wait()
    steps = [b - a for a, b in itertools.pairwise(deadlines)]
    assert all(step % rate.period_ns == 0 for step in steps), "a late tick must not shift the ones after it"


def test_missed_periods_are_counted_and_skipped() -> None:
    deadlines: list[int] = []

    def sleep(instant_ns: int) -> None:
        deadlines.append(instant_ns)
        sleep_until(instant_ns)

    rate = Rate(100.0, sleep=sleep)
    rate.wait()
    sleep_until(time.monotonic_ns() + 55_000_000)
    before_ns = time.monotonic_ns()
    rate.wait()
    assert rate.overruns >= 4
    assert deadlines[-1] > before_ns - rate.period_ns, "the next tick is a fresh one, not a missed one"
    assert rate.stats().overruns == rate.overruns


def test_stats_tell_rate_and_lateness() -> None:
    rate = Rate(200.0)
    assert rate.stats().rate_hz == 0.0
    for _ in range(50):
        rate.wait()
    stats = rate.stats()
    assert 0.0 <= stats.jitter_p50_ms <= stats.jitter_p99_ms
    assert stats.rate_hz > 0.0


def test_what_is_urgent_does_not_wait_for_its_tick() -> None:
    rate, urgent = Rate(0.01), threading.Event()
    rate.wait(urgent)
    timer = threading.Timer(0.05, urgent.set)
    timer.start()
    rate.wait(urgent)  # else it would take a hundred seconds
    assert urgent.is_set()
    assert rate.overruns == 0
    timer.join()


def test_later_deadlines_count_from_the_tick_that_came_early() -> None:
    deadlines: list[int] = []
    rate, urgent = Rate(1.0, sleep=deadlines.append), threading.Event()
    urgent.set()
    rate.wait(urgent)
    began_ns = time.monotonic_ns()
    rate.wait()
    assert deadlines[0] <= began_ns + rate.period_ns


def test_who_is_urgent_all_the_time_cannot_make_the_loop_run_away() -> None:
    deadlines: list[int] = []
    rate, urgent = Rate(0.01, sleep=deadlines.append), threading.Event()
    urgent.set()
    for _ in range(10):
        rate.wait(urgent)
    assert len(deadlines) == 5, "every other tick waits for its deadline"
