"""The stamp beside every key: the writer of its value, the time, and the writer's count of writes.

A native writer sets ``key`` and ``key@`` in one ``MSET``. The stamp is ASCII text, fields separated by a space:
``seq mono_ns wall_ns source [capture_ns]``. Stock TWIST scripts neither write nor read it.
"""

from __future__ import annotations

import os
import secrets
from functools import cache, lru_cache
from pathlib import Path

import msgspec

SUFFIX = "@"

_INT64 = 1 << 63


class Stamp(msgspec.Struct, frozen=True):
    """One write.

    Attributes:
        seq: Number of this write among the writes of this source to this key, from 1.
        mono_ns: Writer's monotonic clock [ns]; comparable only between processes of one `boot`.
        wall_ns: Writer's wall clock, nanoseconds since the Unix epoch.
        source: ``name.pid.boot.token``: server name, process, machine boot, one random token per process start.
        capture_ns: Device's own time of capture [ns], on the device's clock; None where there is no device.
    """

    seq: int
    mono_ns: int
    wall_ns: int
    source: str
    capture_ns: int | None = None

    @property
    def writer(self) -> str:
        """Name of the server that wrote it."""
        return self.source.split(".", 1)[0]

    @property
    def pid(self) -> str:
        """Number of the process that wrote it; "?" where its source names none."""
        return next(iter(self.source.split(".")[1:2]), "?")

    @property
    def is_from_this_boot(self) -> bool:
        """Whether `mono_ns` is comparable with this process's monotonic clock."""
        return boot_of(self.source) == boot_id()

    def encode(self) -> bytes:
        """Return the stamp as it stands on the bus."""
        tail = b"" if self.capture_ns is None else b" %d" % self.capture_ns
        return b"%d %d %d %s%s" % (self.seq, self.mono_ns, self.wall_ns, self.source.encode(), tail)


def decode(data: bytes) -> Stamp | None:
    """Return the stamp that bytes from the bus hold, or None when they are none of ours."""
    fields = data.split(b" ")
    if len(fields) not in (4, 5):
        return None
    try:
        capture = integer(fields[4]) if len(fields) == 5 else None
        return Stamp(integer(fields[0]), integer(fields[1]), integer(fields[2]), fields[3].decode("ascii"), capture)
    except ValueError:
        return None


def integer(digits: bytes) -> int:
    """Return the number that a field holds.

    Raises:
        ValueError: it holds none, or one of more than 64 bits.
    """
    value = int(digits)
    if not -_INT64 <= value < _INT64:
        raise ValueError(f"a number of {len(digits)} digits, expected at most 64 bits")
    return value


def new_source(name: str) -> str:
    """Return the source of a process that starts now under a server name."""
    return f"{name.replace('.', '-').replace(' ', '-')}.{os.getpid()}.{boot_id()}.{secrets.token_hex(2)}"


@lru_cache(maxsize=64)  # for each value that is read it is asked twice
def boot_of(source: str) -> str:
    """Return the boot that a source names, whose monotonic clock it has; "" where it names none."""
    return next(iter(source.split(".")[2:3]), "")


@cache
def boot_id() -> str:
    """Return eight hex digits that name this boot of this machine; monotonic clocks compare only within it."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip().replace("-", "")[:8]
    except OSError:  # not Linux: no boot id, so no other process's monotonic clock is trusted
        return secrets.token_hex(4)
