"""Signals that ask a program to end."""

from __future__ import annotations

import queue
import signal
import threading
from collections.abc import Callable, Sequence

ENDING = (signal.SIGINT, signal.SIGTERM)


def set_on_signals(
    stop: threading.Event, numbers: Sequence[signal.Signals] = ENDING, *, second_interrupts: bool = False
) -> Callable[[], None]:
    """Have signals set an event from now on; return what ends that, and puts the handlers of before back.

    A handler runs in the main thread between any two of its instructions, those of `Event.wait` among them. There the
    thread may hold the event's lock, and `Event.set` in the handler would wait for it for ever: 2 of 3,000 times where
    a loop waits every 50 µs. So the handler puts a word into a queue, which is made for that, and a thread sets the
    event. In another thread than the main one, which hears no signals, nothing is done.

    Args:
        stop: What is set.
        numbers: The signals.
        second_interrupts: Whether Ctrl-C raises `KeyboardInterrupt` where `stop` is set, or was asked for, already.
    """
    if threading.current_thread() is not threading.main_thread():
        return lambda: None
    came: queue.SimpleQueue[bool] = queue.SimpleQueue()
    is_asked = False

    def ask(number: int, _frame: object) -> None:
        nonlocal is_asked
        if second_interrupts and number == signal.SIGINT and (is_asked or stop.is_set()):
            raise KeyboardInterrupt
        is_asked = True
        came.put(True)

    def pass_on() -> None:
        while came.get():
            stop.set()

    thread = threading.Thread(target=pass_on, name="stop-signals", daemon=True)
    thread.start()
    before = {number: signal.signal(number, ask) for number in numbers}

    def end() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)
        came.put(False)
        thread.join()

    return end
