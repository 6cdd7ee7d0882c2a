"""Signals that ask a program to end, whenever they come."""

from __future__ import annotations

import re
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from station.stop_signals import set_on_signals
from tests.waiting import DEADLINE_S

ROOT = Path(__file__).parents[1]


@pytest.fixture
def stop() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set, a second Ctrl-C interrupts."""
    event = threading.Event()
    end = set_on_signals(event, second_interrupts=True)
    yield event
    end()


@pytest.mark.timeout(30)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_one_that_comes_while_the_main_thread_begins_to_wait_for_the_event_sets_it(
    stop: threading.Event, number: signal.Signals
) -> None:
    with stop._cond:  # type: ignore[attr-defined]  # as within `stop.wait`
        signal.raise_signal(number)
    assert stop.wait(DEADLINE_S)


def test_a_second_ctrl_c_interrupts_and_a_second_sigterm_does_not(stop: threading.Event) -> None:
    signal.raise_signal(signal.SIGTERM)
    signal.raise_signal(signal.SIGTERM)
    assert stop.wait(DEADLINE_S)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_afterwards_signals_do_what_they_did_before_and_no_thread_is_left() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    threads = set(threading.enumerate())
    set_on_signals(threading.Event())()
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    assert set(threading.enumerate()) <= threads


def test_beside_the_main_thread_nothing_is_done() -> None:
    before, done = signal.getsignal(signal.SIGINT), []
    thread = threading.Thread(target=lambda: done.append(set_on_signals(threading.Event())()))
    thread.start()
    thread.join()
    assert (done, signal.getsignal(signal.SIGINT)) == ([None], before)


def test_no_handler_sets_an_event_itself() -> None:
    handlers = re.compile(r"signal\.signal\(.*\.set\b")
    files = [file for folder in ("station", "servers", "adapters", "tests") for file in (ROOT / folder).rglob("*.py")]
    assert [file.relative_to(ROOT) for file in files if handlers.search(file.read_text(encoding="utf-8"))] == []


def test_no_other_handler_may_take_a_lock() -> None:
    """A handler that waits for a lock of its own thread waits for ever; look at each new one before it stands here."""
    files = [file for folder in ("station", "servers", "adapters") for file in (ROOT / folder).rglob("*.py")]
    handling = {str(file.relative_to(ROOT)) for file in files if "signal.signal(" in file.read_text(encoding="utf-8")}
    assert handling == {
        "station/stop_signals.py",  # puts a word into a queue that is made for it
        "station/side_by_side.py",  # appends to a list
        "station/cli/devices.py",  # raises
    }


def test_nobody_waits_for_a_time_in_a_queue_that_a_signal_may_make_wait_for_ever() -> None:
    """`SimpleQueue.get` of CPython 3.11 waits without end where a signal comes as its time is over."""
    found = [
        path.relative_to(ROOT)
        for folder in ("station", "servers", "adapters", "bridges")
        for path in (ROOT / folder).rglob("*.py")
        if "SimpleQueue[" in (text := path.read_text(encoding="utf-8")) and ".get(timeout=" in text
    ]
    assert found == []
