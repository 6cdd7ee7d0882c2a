"""Fixed-rate loops: absolute deadlines, so that a late tick does not shift the ones after it.

A script that sleeps ``period - elapsed`` runs 9 % slow under load; a deadline on the monotonic clock does not drift.
What no deadline can give is the processor at the right instant: that takes real-time scheduling, see `real_time`.
"""

from __future__ import annotations

import ctypes
import gc
import os
import threading
from collections import deque
from pathlib import Path

import msgspec

from station.clock import SYSTEM, Clock

_PR_SET_TIMERSLACK = 29
_WINDOW = 500  # ticks: ten seconds at 50 Hz


class LoopStats(msgspec.Struct, frozen=True):
    """How a loop has kept its time lately.

    Attributes:
        rate_hz: Ticks per second over the window.
        nominal_hz: Ticks per second that there are to be.
        jitter_p50_ms, jitter_p99_ms: How late after its deadline a tick woke [ms].
        overruns: Periods missed since the start.
    """

    rate_hz: float
    nominal_hz: float
    jitter_p50_ms: float
    jitter_p99_ms: float
    overruns: int


class Rate:
    """Deadlines a period apart.

    Args:
        hz: Rate [Hz].
        clock: By which it waits.
    """

    def __init__(self, hz: float, clock: Clock = SYSTEM) -> None:
        self.period_ns = round(1e9 / hz)
        self.overruns = 0
        self._clock = clock
        self._deadline_ns: int | None = None
        self._came_early = False
        self._wakes: deque[tuple[int, int]] = deque(maxlen=_WINDOW)

    def wait(self, urgent: threading.Event | None = None) -> None:
        """Sleep until the next deadline; deadlines that have passed are counted and skipped, never made up for.

        Where `urgent` is or gets set the tick comes at once and later deadlines count from it; but never two ticks in
        a row, so that setting it all the time cannot make the loop run away.
        """
        now_ns = self._clock.monotonic_ns()
        if self._deadline_ns is None:
            self._deadline_ns = now_ns
        else:
            self._deadline_ns += self.period_ns
        late = (now_ns - self._deadline_ns) // self.period_ns
        if late >= 1:
            self.overruns += late
            self._deadline_ns += late * self.period_ns
        if urgent is None or self._came_early:
            self._came_early = False
            self._clock.sleep_until(self._deadline_ns)
        elif self._clock.wait(urgent, max(0.0, (self._deadline_ns - now_ns) * 1e-9)):
            self._came_early = True
            self._deadline_ns = min(self._deadline_ns, self._clock.monotonic_ns())
        woke_ns = self._clock.monotonic_ns()
        self._wakes.append((woke_ns, woke_ns - self._deadline_ns))

    def shift(self, seconds: float) -> None:
        """Move the deadlines from the next one on; later where positive [s]."""
        if self._deadline_ns is not None:
            self._deadline_ns += round(seconds * 1e9)

    def stats(self) -> LoopStats:
        """Return how the loop has kept its time over the last ten seconds or so."""
        wakes, nominal_hz = list(self._wakes), 1e9 / self.period_ns
        if len(wakes) < 2:
            return LoopStats(0.0, nominal_hz, 0.0, 0.0, self.overruns)
        late_ms = sorted(late_ns * 1e-6 for _, late_ns in wakes)
        rate_hz = (len(wakes) - 1) / ((wakes[-1][0] - wakes[0][0]) * 1e-9)
        return LoopStats(rate_hz, nominal_hz, _quantile(late_ms, 0.5), _quantile(late_ms, 0.99), self.overruns)


def _quantile(ordered: list[float], share: float) -> float:
    """As `np.quantile`, which takes 0.2 ms in a loop and, at its first call, 8 ms more to load `numpy.ma`."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (place - below)


def real_time(priority: int = 50) -> str:
    """Make this process as punctual as the system lets it, after start-up and before the first tick.

    Freezes what is allocated (a full collection of a large heap stops a loop for 80 ms), asks for the finest timer
    and, where permitted, for SCHED_FIFO on every thread. Returns what was obtained, for the server's status.
    """
    gc.collect()
    gc.freeze()
    _finest_timer()
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except (PermissionError, FileNotFoundError, AttributeError) as error:
        return f"normal scheduling ({type(error).__name__}: real-time scheduling is not permitted)"
    return f"SCHED_FIFO {priority}"


def _finest_timer() -> None:
    """Lower the kernel's timer slack from 50 us to 1 ns for this thread, where there is such a thing."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
