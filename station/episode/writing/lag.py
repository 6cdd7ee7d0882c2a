"""How long things take, over the newest few hundred: enough for a median and a 99th percentile in a status line."""

from __future__ import annotations

from collections import deque

_WINDOW = 1024


class Lag:
    """Keeps the newest durations; written by one thread, read by another."""

    def __init__(self) -> None:
        self._newest_ns: deque[int] = deque(maxlen=_WINDOW)
        self.longest_ns = 0

    def note(self, duration_ns: int) -> None:
        """Add one duration [ns]."""
        self._newest_ns.append(duration_ns)
        self.longest_ns = max(self.longest_ns, duration_ns)

    def percentile_ms(self, percent: float) -> float | None:
        """Return a percentile of the newest durations [ms], or None before the first."""
        ordered = sorted(self._newest_ns.copy())
        if not ordered:
            return None
        return round(ordered[min(len(ordered) - 1, int(len(ordered) * percent / 100))] * 1e-6, 3)
