"""The silence that commands must begin with before a robot that was stopped follows them again. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

_ROUNDING = 1e-9  # 75 ticks of 4 ms are 0.3 s


class QuietTime(NamedTuple):
    """How quiet it is where commands come from.

    Attributes:
        for_s: For how long nothing has come and all of it would have been heard [s]; infinite, or no number, where
            nothing ever came.
        unheard_s: For how long nobody knows whether something was written, up to now [s]: a bus that is cut or frozen
            tells nothing, and one that is well is asked only so often.
    """

    for_s: float
    unheard_s: float = 0.0


class ReengageInterlock:
    """Counts for how long nothing has come since silence was insisted on.

    Only time that was waited through counts. What came before does not, and neither does what a stalled process or a
    clock that leaps has not heard: a hole in a stream around the instant of a reset is not somebody who let go. Nor
    does time of which it is not known that nothing was written in it.

    Args:
        needed_s: Longer than this has nothing to come [s].
    """

    def __init__(self, needed_s: float) -> None:
        self._needed_s = needed_s
        self._heard_s: float | None = None  # None: from the next tick on
        self._why = ""

    @property
    def missing(self) -> str:
        """Why no command may be followed yet, or ""."""
        return f"{self._why}; let go, then engage anew" if self._why else ""

    def insist(self, why: str) -> None:
        """Let nobody be followed before there was a silence from now on, for a reason."""
        self._why, self._heard_s = why, None

    def hear(self, quiet: QuietTime, passed_s: float) -> None:
        """Record a tick.

        Args:
            quiet: As it is now.
            passed_s: How much time the tick counts for [s].
        """
        if not self._why:
            return
        if self._heard_s is None:
            self._heard_s = 0.0
            return
        for_s = math.inf if math.isnan(quiet.for_s) else max(quiet.for_s, 0.0)
        self._heard_s = min(self._heard_s + passed_s, for_s)
        if self._heard_s - quiet.unheard_s > self._needed_s + _ROUNDING:  # never where that is no number
            self._why = ""
