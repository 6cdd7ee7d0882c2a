"""Whether this process stood still, where what comes from elsewhere says no time: what waited meanwhile is that old.

A socket hands over what lay in the kernel, or with a thread of a library, as if it came in this instant.
"""

from __future__ import annotations

from station.clock import Clock

PAUSED_S = 0.1
"""A process that has not looked for so long stood still [s]."""

_SETTLE_S = 0.05  # in which a library's threads hand over what waited


class Pauses:
    """When what is read now came. Call `begin` before each wait, `end` behind it, `done` once all is read.

    Args:
        clock: The clock.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._looked_s = self._began_s = clock.monotonic_s()
        self._old: tuple[float, float] | None = None  # what is read until the one instant came at the other

    def begin(self) -> None:
        """A wait begins."""
        self._began_s = self._clock.monotonic_s()

    def end(self, timeout_s: float) -> None:
        """A wait of at most a time [s] has ended."""
        now_s = self._clock.monotonic_s()
        if self._began_s - self._looked_s > PAUSED_S:
            self._old = now_s + _SETTLE_S, self._looked_s
        elif now_s - self._began_s > timeout_s + PAUSED_S:
            self._old = now_s + _SETTLE_S, self._began_s

    def came_s(self) -> float:
        """Return when what is read now came [s]."""
        self._looked_s = self._clock.monotonic_s()
        return self._looked_s if self._old is None else self._old[1]

    def done(self, *, is_empty: bool) -> None:
        """All that there was is read, or as much as one look may read."""
        self._looked_s = self._clock.monotonic_s()
        if is_empty and self._old is not None and self._looked_s > self._old[0]:
            self._old = None
