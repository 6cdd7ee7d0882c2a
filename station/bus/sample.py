"""One value of the bus as a reader got it."""

from __future__ import annotations

import math

import msgspec

from station.bus.clocks import Offset
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
        clock: How its writer's clock is to be read here, where it runs on another machine; None where that is unknown.
    """

    key: str
    value: bytes
    stamp: Stamp | None
    arrived_ns: int | None
    clock: Offset | None = None

    @property
    def written_ns(self) -> int | None:
        """When it was written, on the reader's monotonic clock [ns]; None where that is unknown.

        It is known of a writer on this machine (`Stamp.is_from_this_boot`), and of one on another machine whose clock
        is known, to within the error of that. Within it nothing was written after it arrived.
        """
        if self.stamp is None:
            return None
        if self.stamp.is_from_this_boot:
            return self.stamp.mono_ns
        if self.clock is None:
            return None
        written_ns = self.stamp.mono_ns + self.clock.ns
        is_too_late = self.arrived_ns is not None and 0 < written_ns - self.arrived_ns <= self.clock.error_ns
        return self.arrived_ns if is_too_late else written_ns

    @property
    def delay_s(self) -> float | None:
        """Return the time from its writing to its arrival [s]; None where one of the two is unknown.

        A negative time says that the stamp is not of its writer's clock, since nothing arrives before it was written.
        """
        written_ns = self.written_ns
        if written_ns is None or self.arrived_ns is None:
            return None
        return min(max(self.arrived_ns - written_ns, -_LONGEST_NS), _LONGEST_NS) * 1e-9  # a stamp may say anything

    def age_s(self, now_ns: int) -> float:
        """Return its age at an instant of the reader's clock [s]; infinite when it was there before we looked."""
        if self.arrived_ns is None:
            return math.inf
        return (now_ns - self.arrived_ns) * 1e-9
