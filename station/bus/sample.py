"""One value of the bus as a reader got it."""

from __future__ import annotations

import math
import time

import msgspec

from station.bus.stamp import Stamp


class Sample(msgspec.Struct, frozen=True):
    """A value and how fresh it is.

    Attributes:
        key: The key it was read from.
        value: Its bytes.
        stamp: Stamp of its write; None for a foreign writer.
        arrived_ns: When it reached this reader, on the reader's monotonic clock [ns]; None when it was there before
            the reader looked, so that nothing is known of its age.
    """

    key: str
    value: bytes
    stamp: Stamp | None
    arrived_ns: int | None

    def age_s(self, now_ns: int | None = None) -> float:
        """Return the time since it arrived [s]; infinite when it was there before we looked."""
        if self.arrived_ns is None:
            return math.inf
        return ((time.monotonic_ns() if now_ns is None else now_ns) - self.arrived_ns) * 1e-9
