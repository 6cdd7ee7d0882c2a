"""Time, and every wait for it: given to what runs between the bus and the robot, never read by it.

A server runs on `SYSTEM`. A test gives a clock of its own: the same code then runs in virtual time, thousands of trials
in one process, each the same for the same seed. So code that is given a `Clock` reads no other, and waits by no other.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

Thread = threading.Thread
"""What `Clock.start` returns, for annotations."""


class Clock:
    """The machine's clock."""

    def monotonic_ns(self) -> int:
        """Return the instant on the monotonic clock [ns]."""
        return time.monotonic_ns()

    def monotonic_s(self) -> float:
        """Return the instant on the monotonic clock [s]."""
        return self.monotonic_ns() * 1e-9

    def wall_ns(self) -> int:
        """Return the time since 1970-01-01 UTC [ns]; it may be set back."""
        return time.time_ns()

    def sleep_until(self, instant_ns: int) -> None:
        """Sleep until an instant of the monotonic clock [ns]; return at once when it has passed."""
        remaining_ns = instant_ns - self.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns * 1e-9)

    def sleep(self, seconds: float) -> None:
        """Sleep for a time [s]."""
        self.sleep_until(self.monotonic_ns() + round(seconds * 1e9))

    def wait(self, event: threading.Event, timeout_s: float | None = None) -> bool:
        """Wait until an event is set, or for a time [s]; return whether it is set."""
        return event.wait(timeout_s)

    def wait_for(
        self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float | None = None
    ) -> bool:
        """Wait, with the condition's lock taken, until a predicate holds, or for a time [s]; return whether it does."""
        return condition.wait_for(predicate, timeout_s)

    def lock(self) -> AbstractContextManager[object]:
        """Return a lock that may be held while its holder waits; others then wait for it by this clock."""
        return threading.Lock()

    def start(self, target: Callable[[], None], name: str) -> Thread:
        """Start a daemon thread that reads this clock."""
        thread = Thread(target=target, name=name, daemon=True)
        thread.start()
        return thread

    def join(self, thread: Thread, timeout_s: float | None = None) -> None:
        """Wait until a thread has ended, or for a time [s]."""
        thread.join(timeout_s)


SYSTEM = Clock()
