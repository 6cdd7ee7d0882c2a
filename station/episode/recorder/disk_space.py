"""Whether the disk has room for an episode, and for how long: asked before the start, watched while it grows."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from station.clock import SYSTEM, Clock
from station.episode.recorder.options import Notice, RecordingOptions

if TYPE_CHECKING:
    from station.bus.tap import Write


_RECORD_BYTES = 64  # around the value of a message in the file
_BUS_SPAN_S = 5.0  # long enough for what is written once a second
_FILE_SPAN_S = 30.0  # a file grows in flushes, and a camera's pictures with what it sees
_SETTLED_S = 5.0  # of growth, before it is worth more than the rate on the bus
_ASK_S = 0.05  # a healthy disk answers in 0.1 ms; the reader of the bus waits for a sick one no longer than this
_STUCK_S = 5.0
_WELL_AGAIN = 2.0

_LOOK_EVERY_S = 1.0


class Meter:
    """The rate at which a count of bytes grows, over the last seconds.

    Args:
        span_s: How far back it reaches [s].
    """

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._points: deque[tuple[float, int]] = deque()

    def update(self, at_s: float, count: int) -> None:
        """Set how much there is now."""
        self._points.append((at_s, count))
        while self.seconds > self._span_s and len(self._points) > 2:
            self._points.popleft()

    @property
    def seconds(self) -> float:
        """How long it has been measured [s]."""
        return self._points[-1][0] - self._points[0][0] if self._points else 0.0

    @property
    def bytes_per_s(self) -> float:
        """The rate; what came within less than a second counts as that of a second."""
        return (self._points[-1][1] - self._points[0][1]) / max(1.0, self.seconds) if self._points else 0.0


class DiskSpace:
    """The disk of a recorder, and what needs it. Belongs to the reader of the bus, which it never holds up.

    The rate of an episode is what its file grew by in the last half minute; before its first seconds are over, and
    between episodes, it is what is written on the bus, uncompressed, which is more.

    Args:
        options: Data folder, what stays free, when to warn.
        clock: The recorder's.
    """

    def __init__(self, options: RecordingOptions, clock: Clock = SYSTEM) -> None:
        self._options, self._clock = options, clock
        self._space = FreeSpace(options.data, clock)
        self._bus, self._file = Meter(_BUS_SPAN_S), Meter(_FILE_SPAN_S)
        self._bus.update(self._clock.monotonic_s(), 0)
        self._bus_bytes = 0
        self._seen = self._space.look.number
        self._warned_min: float | None = None
        self._is_stuck = False

    def close(self) -> None:
        """Stop looking."""
        self._space.close()

    def count(self, writes: Sequence[Write]) -> None:
        """Count what was just written on the bus."""
        self._bus_bytes += sum(_RECORD_BYTES + len(write[1]) if write[1] is not None else 0 for write in writes)

    def refusal(self, planned_s: float | None) -> str | None:
        """Return why an episode of a planned length [s] cannot begin, or None when it can.

        Without a plan it is the planned time of the options: a minute, unless told otherwise. It must fit at the rate
        of the last seconds on the bus, beside what stays free.
        """
        data, look = self._options.data, self._space.fresh(_ASK_S)
        if (silent_s := self._space.silent_s) > _STUCK_S:
            return f"data folder {data}: its disk is silent for {silent_s:.0f} s; repair it, or use another with --data"
        if look.trouble:
            return f"data folder {data}: {look.trouble}, or name another with --data"
        self._measure(look)
        planned_s = self._options.planned_s if planned_s is None else planned_s
        rate = self._bus.bytes_per_s
        wanted = self._options.min_free_mb * 1e6 + planned_s * rate
        if look.free_bytes is None or look.free_bytes >= wanted:
            return None
        is_for_plan = look.free_bytes >= self._options.min_free_mb * 1e6
        what = f" ({planned_s:g} s at {rate * 1e-6:.2f} MB/s, and {self._options.min_free_mb:.0f} MB that stay free)"
        return (
            f"data folder {data}: {look.free_bytes * 1e-6:.0f} MB free, at least {wanted * 1e-6:.0f} MB wanted"
            f"{what if is_for_plan else ''}; free some, or name another with --data"
        )

    def begin(self) -> None:
        """Record that an episode begins."""
        self._file = Meter(_FILE_SPAN_S)
        self._warned_min = None

    def follow(self, size: int | None) -> list[Notice]:
        """Check for news of the disk; return what is to be published of it.

        Args:
            size: Bytes of the present episode on the disk; None when there is no episode.
        """
        look, notices = self._space.look, []
        is_stuck = self._space.silent_s > _STUCK_S
        if is_stuck != self._is_stuck:
            self._is_stuck = is_stuck
            notices.append(self._news("disk-stuck" if is_stuck else "disk-answers", is_bad=is_stuck))
        if look.number == self._seen:
            return notices
        self._measure(look)
        if size is None:
            self._file = Meter(_FILE_SPAN_S)
        else:
            self._file.update(look.at_s, size)
            notices += self._warning()
        return notices

    @property
    def is_used_up(self) -> bool:
        """Whether an episode should end, while what stays free is still there to end it in."""
        free = self._space.look.free_bytes
        return free is not None and free < self._options.min_free_mb * 1e6

    @property
    def used_up(self) -> str:
        """Why it should, in a line."""
        return (
            f"the disk of {self._options.data} is full but for the {self._options.min_free_mb:.0f} MB that stay free; "
            "free some, then start a new episode"
        )

    @property
    def free_mb(self) -> float | None:
        """Free space [MB]; None where unknown."""
        free = self._space.look.free_bytes
        return None if free is None else round(free * 1e-6, 1)

    @property
    def bytes_per_s(self) -> float:
        """The rate at which an episode fills the disk."""
        return (self._file if self._file.seconds >= _SETTLED_S else self._bus).bytes_per_s

    @property
    def minutes_left(self) -> float | None:
        """How long an episode could go on until it were ended [min]; None where unknown, or for ever."""
        free, rate = self._space.look.free_bytes, self.bytes_per_s
        if free is None or not rate > 0:
            return None
        return round(max(0.0, free - self._options.min_free_mb * 1e6) / rate / 60, 2)

    def _measure(self, look: DiskReading) -> None:
        self._seen = look.number
        self._bus.update(self._clock.monotonic_s(), self._bus_bytes)

    def _warning(self) -> list[Notice]:
        """Warn below the limit, and again at each half of what was said; say when all is well again."""
        left, limit, warned = self.minutes_left, self._options.warn_minutes, self._warned_min
        if self._file.seconds < _SETTLED_S:
            return []
        if warned is not None and (left is None or left > _WELL_AGAIN * limit):
            self._warned_min = None
            return [self._news("disk-ok", is_bad=False)]
        if left is None or not (left <= limit if warned is None else left < warned / 2):
            return []
        self._warned_min = left
        return [self._news("disk-low", is_bad=True)]

    def _news(self, name: str, *, is_bad: bool) -> Notice:
        numbers: dict[str, Any] = {
            "minutes_left": self.minutes_left, "free_mb": self.free_mb,
            "mb_per_minute": round(self.bytes_per_s * 60e-6, 2), "data": str(self._options.data),
        }  # fmt: skip
        return Notice(name, "warning" if is_bad else "info", numbers)


class DiskReading(NamedTuple):
    """What one look found.

    Attributes:
        number: Counts the looks, from 1.
        at_s: When it was taken [s, monotonic].
        free_bytes: What an ordinary user may still write; None where the file system does not tell.
        trouble: Why nothing can be written, "" otherwise.
    """

    number: int
    at_s: float
    free_bytes: int | None
    trouble: str


class FreeSpace:
    """Looks once a second; nothing here waits for the disk but `__init__`.

    Args:
        data: Data folder, or where it will be made.
        clock: The recorder's.
    """

    def __init__(self, data: Path, clock: Clock = SYSTEM) -> None:
        self._data, self._clock = data, clock
        self._mount = mount_point(data)
        self._wake = threading.Condition()
        self._is_asked = self._is_closed = False
        self._began_s: float | None = None  # of the look that is being taken
        self.look = self._read(1)
        clock.start(self._watch, "free space")

    def fresh(self, timeout_s: float) -> DiskReading:
        """Have a look taken now and wait for it, at most so long; return the newest there is."""
        with self._wake:
            seen = self.look.number
            self._is_asked = True
            self._wake.notify_all()
            self._clock.wait_for(self._wake, lambda: self.look.number > seen, timeout_s)
            return self.look

    @property
    def silent_s(self) -> float:
        """How long the disk has owed an answer [s]; 0 when it owes none."""
        began_s = self._began_s
        return 0.0 if began_s is None else self._clock.monotonic_s() - began_s

    def close(self) -> None:
        """End the thread, as soon as the disk lets it."""
        with self._wake:
            self._is_closed = True
            self._wake.notify_all()

    def _watch(self) -> None:
        while True:
            with self._wake:
                self._clock.wait_for(self._wake, lambda: self._is_asked or self._is_closed, _LOOK_EVERY_S)
                if self._is_closed:
                    return
                self._is_asked = False
            self._began_s = self._clock.monotonic_s()
            look = self._read(self.look.number + 1)
            self._began_s = None
            with self._wake:
                self.look = look
                self._wake.notify_all()

    def _read(self, number: int) -> DiskReading:
        try:
            # Without its disk the folder would be made on the one beneath, and hidden when the disk comes back.
            is_mounted = os.path.ismount(self._mount)
            folder = nearest_folder(self._data)
            found = os.statvfs(folder)
            free = found.f_bavail * found.f_frsize if found.f_blocks else None  # some have no size, such as tmpfs
            if not is_mounted:
                free = None  # it is that of the disk beneath
                trouble = f"no disk is mounted at {self._mount} any more; mount it"
            elif not os.access(folder, os.W_OK):
                trouble = f"{folder} cannot be written; make it writable"
            else:
                trouble = ""
        except OSError as error:
            free, trouble = None, error.strerror or str(error)
        return DiskReading(number, self._clock.monotonic_s(), free, trouble)


def nearest_folder(path: Path) -> Path:
    """Return a path, or where it is not there the nearest of its parents that is."""
    path = path.absolute()
    return next((found for found in (path, *path.parents) if found.exists()), path)


def mount_point(path: Path) -> Path:
    """Return where the file system of a path is mounted."""
    folder = nearest_folder(path)
    return next((found for found in (folder, *folder.parents) if os.path.ismount(found)), folder)
