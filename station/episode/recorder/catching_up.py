"""A recorder that went on where the one before it was killed has caught up when nothing waits for it any more."""

from __future__ import annotations

from collections.abc import Callable

from station.bus.tap import Tap

_FULL = 3 / 8  # of the queue before the disk: before anything is dropped
_DRAINED = 1 / 4
_LONGEST_S = 20.0  # as an asker waits for the recorder's answer, which comes in the order of the stream


class CatchingUp:
    """Says when a tap that is late is to be read: as long as the bus can keep what the disk cannot take, not before.

    Late is a tap that was resumed, until it has read what was written while no tap was there, and the queue before the
    disk has drained once. What comes meanwhile waits at the bus; read at once, it would be dropped. Where the disk
    stays slower than what is written, the bus would have to keep more and more: then, or where what is read is still
    20 s old after 20 s, all is read, and the queue drops what it must; the event `recorder-behind` says so.

    Args:
        tap: The tap.
        now_s: The time [s, monotonic].
        tell: Publishes an event.

    Attributes:
        is_late: Whether what the tap returns was written long before it came.
    """

    def __init__(self, tap: Tap, now_s: float, tell: Callable[..., None]) -> None:
        self._tap, self._tell = tap, tell
        self._ends_s = now_s + _LONGEST_S
        self.is_late = tap.is_catching_up

    def must_wait(self, load: float, now_s: float, written_s: float) -> bool:
        """Return whether the tap is not to be read now, and record how far it is.

        Args:
            load: How full the queue before the disk is, 0..1.
            now_s: The time [s, monotonic].
            written_s: When the newest write was written that the tap returned [s, monotonic].
        """
        if self.is_late and now_s >= self._ends_s and now_s - written_s > _LONGEST_S:
            self.is_late = False
            self._tell("recorder-behind", severity="warning", behind_s=round(now_s - written_s, 3))
        elif load < _DRAINED and not self._tap.is_catching_up:
            self.is_late = False
        return self.is_late and load > _FULL and self._tap.may_wait()
