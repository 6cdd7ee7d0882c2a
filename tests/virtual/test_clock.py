"""Virtual time: it passes only while all wait, every order of what is ready is possible, and a seed repeats it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from tests.virtual.clock import Deadlock, ThreadFailed, VirtualClock

HOUR_S = 3600.0
MS = 1_000_000


def test_an_hour_passes_at_once() -> None:
    with VirtualClock() as clock:
        began_ns = clock.monotonic_ns()
        clock.sleep(HOUR_S)
        assert clock.monotonic_ns() - began_ns == HOUR_S * 1e9
        assert not clock.wait(threading.Event(), HOUR_S)


def order_of(seed: int) -> str:
    """Return in which order three threads that wake at the same instants run."""
    order = []

    def run(name: str) -> Callable[[], None]:
        def ticks() -> None:
            for _ in range(4):
                clock.sleep(0.01)
                order.append(name)

        return ticks

    with VirtualClock(seed) as clock:
        threads = [clock.start(run(name), name) for name in "abc"]
        for thread in threads:
            clock.join(thread)
    return "".join(order)


def test_a_seed_repeats_a_run_and_seeds_explore_the_orders() -> None:
    orders = [order_of(seed) for seed in range(60)]
    assert orders == [order_of(seed) for seed in range(60)]
    assert len(set(orders)) > 40
    assert {order[:3] for order in orders} == {"abc", "acb", "bac", "bca", "cab", "cba"}
    assert all(sorted(order[tick : tick + 3]) == ["a", "b", "c"] for order in orders for tick in (0, 3, 6, 9))


def test_who_waits_for_an_event_or_a_condition_goes_on_when_it_holds() -> None:
    event, changed, box = threading.Event(), threading.Condition(), list[int]()

    def produce() -> None:
        clock.sleep(0.5)
        event.set()
        clock.sleep(0.5)
        with changed:
            box.append(7)
            changed.notify_all()

    with VirtualClock() as clock:
        began_s = clock.monotonic_s()
        clock.start(produce, "producer")
        assert clock.wait(event, 2.0)
        assert clock.monotonic_s() - began_s == pytest.approx(0.5)
        with changed:
            assert not clock.wait_for(changed, lambda: bool(box), 0.1)
            assert clock.wait_for(changed, lambda: bool(box))
        assert clock.monotonic_s() - began_s == pytest.approx(1.0)


def test_the_shortest_wait_takes_time() -> None:
    with VirtualClock() as clock:
        began_ns = clock.monotonic_ns()
        clock.wait(threading.Event(), 1e-12)
        assert clock.monotonic_ns() > began_ns


def test_who_wakes_late_is_late_by_less_than_was_said() -> None:
    with VirtualClock(3, late_ns=MS) as clock:
        late_ns = []
        for _ in range(100):
            due_ns = clock.monotonic_ns() + 10 * MS
            clock.sleep_until(due_ns)
            late_ns.append(clock.monotonic_ns() - due_ns)
    assert 0 <= min(late_ns) < 0.1 * MS
    assert 0.9 * MS < max(late_ns) < MS


def test_a_lock_is_waited_for() -> None:
    with VirtualClock() as clock:
        lock, order = clock.lock(), list[str]()

        def hold() -> None:
            with lock:
                order.append("held")
                clock.sleep(1.0)
                order.append("let go")

        clock.start(hold, "holder")
        clock.sleep(0.5)
        with lock:
            order.append("ours")
    assert order == ["held", "let go", "ours"]


def test_a_deadlock_says_who_waits_for_what() -> None:
    with VirtualClock(11) as clock:
        clock.spawn(lambda: clock.hold("an answer", lambda: False, None), "g1")
        with pytest.raises(Deadlock, match=r"seed 11\): main/main waits for an event; g1/g1 waits for an answer"):
            clock.wait(threading.Event())


def test_threads_that_only_hand_over_to_each_other_are_a_deadlock() -> None:
    def spin() -> None:
        while True:
            clock.sleep(0.0)

    with VirtualClock() as clock:
        clock.start(spin, "spinner")
        with pytest.raises(Deadlock, match="time does not pass"):
            clock.sleep(1.0)


def test_a_thread_that_fails_fails_the_test() -> None:
    def fail() -> None:
        clock.sleep(0.1)
        raise ValueError("bad")

    with VirtualClock(4) as clock:
        clock.spawn(fail, "g1")
        with pytest.raises(ThreadFailed, match=r"g1/g1: ValueError\('bad'\) \(seed 4\)") as failed:
            clock.sleep(1.0)
    assert isinstance(failed.value.__cause__, ValueError)


def test_a_thread_of_another_kind_may_not_wait() -> None:
    said = []

    def wait() -> None:
        try:
            clock.sleep(1.0)
        except RuntimeError as error:
            said.append(str(error))

    with VirtualClock() as clock:
        stranger = threading.Thread(target=wait, name="stranger")
        stranger.start()
        stranger.join()
    assert said == ["stranger was not started by the clock that it uses"]


def test_a_process_is_frozen_and_killed_with_all_its_threads() -> None:
    ticks = {"first": 0, "second": 0}

    def count(name: str) -> None:
        while True:
            clock.sleep(0.01)
            ticks[name] += 1

    def main() -> None:
        clock.start(lambda: count("second"), "second")
        count("first")

    with VirtualClock() as clock:
        process = clock.spawn(main, "motion")
        clock.sleep(0.105)
        assert ticks == {"first": 10, "second": 10}
        clock.freeze(process, 1.0)
        clock.sleep(0.9)
        assert ticks == {"first": 10, "second": 10}
        clock.sleep(0.2)
        assert min(ticks.values()) > 10
        assert clock.is_running(process)
        before = dict(ticks)
        clock.kill(process)
        clock.sleep(1.0)
        assert (ticks, clock.is_running(process)) == (before, False)


def test_the_wall_clock_may_be_set() -> None:
    with VirtualClock() as clock:
        before_ns, mono_ns = clock.wall_ns(), clock.monotonic_ns()
        clock.wall_ahead_ns -= 60_000 * MS
        clock.sleep(1.0)
        assert clock.wall_ns() - before_ns == -59_000 * MS
        assert clock.monotonic_ns() - mono_ns == 1_000 * MS


def test_threads_that_are_left_end_with_the_clock() -> None:
    with VirtualClock() as clock:
        threads = [clock.start(lambda: clock.sleep(HOUR_S), f"{number}") for number in range(3)]
        clock.sleep(1.0)
    assert not any(thread.is_alive() for thread in threads)
