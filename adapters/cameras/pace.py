"""When the next picture is due, for a source that makes pictures itself."""

from __future__ import annotations

from station.clock import SYSTEM, Clock


class Pace:
    """Deadlines a period apart, counted from the first wait.

    Args:
        fps: Pictures per second [Hz].
        clock: Of the process.

    Attributes:
        index: Of the picture that is due, from 0; those that were missed are counted too.
    """

    def __init__(self, fps: float, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._period_ns = round(1e9 / fps)
        self._start_ns: int | None = None
        self.index = -1

    def wait(self, timeout_s: float) -> int | None:
        """Sleep until the next picture is due, and return when that was on the monotonic clock [ns].

        None when that is later than after so many seconds; those that are overdue are passed over, all but the newest.
        """
        now_ns = self._clock.monotonic_ns()
        if self._start_ns is None:
            self._start_ns = now_ns
        index = max(self.index + 1, (now_ns - self._start_ns) // self._period_ns)
        due_ns = self._start_ns + index * self._period_ns
        wait_s = (due_ns - now_ns) * 1e-9
        if wait_s > 0:
            self._clock.sleep(min(wait_s, timeout_s))
        if wait_s > timeout_s:
            return None
        self.index = index
        return due_ns
