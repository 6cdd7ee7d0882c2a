"""How much room the disk of a data folder has, looked up in a thread of its own: a disk that hangs holds up nobody."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import NamedTuple

from station.clock import SYSTEM, Clock

_LOOK_EVERY_S = 1.0


class Look(NamedTuple):
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
        self.look = self._take(1)
        clock.start(self._watch, "free space")

    def fresh(self, timeout_s: float) -> Look:
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
            look = self._take(self.look.number + 1)
            self._began_s = None
            with self._wake:
                self.look = look
                self._wake.notify_all()

    def _take(self, number: int) -> Look:
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
        return Look(number, self._clock.monotonic_s(), free, trouble)


def nearest_folder(path: Path) -> Path:
    """Return a path, or where it is not there the nearest of its parents that is."""
    path = path.absolute()
    return next((found for found in (path, *path.parents) if found.exists()), path)


def mount_point(path: Path) -> Path:
    """Return where the file system of a path is mounted."""
    folder = nearest_folder(path)
    return next((found for found in (folder, *folder.parents) if os.path.ismount(found)), folder)
