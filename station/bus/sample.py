"""One value of the bus as a reader got it."""

from __future__ import annotations

import math

import msgspec

from station.bus.stamp import Stamp

_LONGEST_NS = 1 << 62


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

    @property
    def delay_s(self) -> float | None:
        """Return the time from its writing to its arrival [s]; None where writer and reader share no clock.

        They share one where they run on one machine (`Stamp.is_from_this_boot`). A negative time says that the stamp
        is not of that clock all the same, since nothing arrives before it was written.
        """
        if self.stamp is None or self.arrived_ns is None or not self.stamp.is_from_this_boot:
            return None
        delay_ns = min(max(self.arrived_ns - self.stamp.mono_ns, -_LONGEST_NS), _LONGEST_NS)  # a stamp may say anything
        return delay_ns * 1e-9

    def age_s(self, now_ns: int) -> float:
        """Return its age at an instant of the reader's clock [s]; infinite when it was there before we looked."""
        if self.arrived_ns is None:
            return math.inf
        return (now_ns - self.arrived_ns) * 1e-9
