"""The clock of an episode: one pair of wall and monotonic time, taken once, that every other time hangs on."""

from __future__ import annotations

from datetime import datetime

import msgspec

from station.bus.stamp import boot_id
from station.clock import SYSTEM, Clock

_INT64 = 1 << 63


class Anchor(msgspec.Struct, frozen=True):
    """One instant on both clocks of this machine.

    Attributes:
        wall_ns: Wall clock, nanoseconds since the Unix epoch.
        mono_ns: Monotonic clock of the same instant [ns].
        boot: The boot that the monotonic clock belongs to, as in `station.bus.stamp.boot_id`.
    """

    wall_ns: int
    mono_ns: int
    boot: str

    def at(self, mono_ns: int) -> int:
        """Return the wall time of a monotonic instant of this boot [ns since the epoch].

        A step of the wall clock during an episode (NTP) thus never bends its time line.
        """
        return self.wall_ns + mono_ns - self.mono_ns


def read_anchor(clock: Clock = SYSTEM) -> Anchor:
    """Read both clocks, the wall clock between two readings of the monotonic one."""
    before = clock.monotonic_ns()
    wall = clock.wall_ns()
    after = clock.monotonic_ns()
    return Anchor(wall_ns=wall, mono_ns=(before + after) // 2, boot=boot_id())


def is_storable(time_ns: int) -> bool:
    """Whether a time fits an MCAP record and its readers' signed 64 bits; a foreign stamp may hold anything."""
    return 0 <= time_ns < _INT64


def iso(wall_ns: int) -> str:
    """Return a wall time [ns since the epoch] as ISO 8601 with milliseconds and the local offset."""
    return datetime.fromtimestamp(wall_ns * 1e-9).astimezone().isoformat(timespec="milliseconds")
