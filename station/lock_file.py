"""Lock files that say which process has them; the kernel drops a lock when its process dies."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from pathlib import Path

_TRIES, _TRY_S = 5, 0.02


class Held(Exception):
    """Another process has a lock; `holder` is its id, "" where it has not said so."""

    def __init__(self, holder: str) -> None:
        super().__init__(f"held by process {holder or 'unknown'}")
        self.holder = holder


def take(path: Path) -> tuple[int, str]:
    """Lock a file, made when missing, and write our process id into it.

    Returns:
        Its descriptor, which holds the lock until it is closed, and the id of the process that had it before, or "".

    Raises:
        Held: another process has it.
        OSError: it cannot be opened.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    is_ours = _flocked(descriptor)
    before = _written_in(descriptor)
    if not is_ours:
        os.close(descriptor)
        raise Held(before)
    with contextlib.suppress(OSError):  # the disk is full: the lock holds, only its owner cannot be read
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, b"%d\n" % os.getpid(), 0)
    return descriptor, before


def is_locked(path: Path) -> bool:
    """Whether a living process holds a file, as its `Disk` or as a lock; the kernel knows."""
    return holder(path) is not None


def holder(path: Path) -> str | None:
    """Return the id of the process that has a lock, "" where it does not say; None where none has it."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe is no reason to wait
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return _written_in(descriptor)
    finally:
        os.close(descriptor)
    return None


def _flocked(descriptor: int) -> bool:
    """Lock a file, with a few tries: `holder` of another process holds the lock for an instant."""
    for _ in range(_TRIES):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except OSError:
            time.sleep(_TRY_S)
    return False


def _written_in(descriptor: int) -> str:
    try:
        text = os.pread(descriptor, 32, 0).decode("ascii", "replace").strip()
    except OSError:  # a pipe, or a disk that is failing
        return ""
    return text if text.isdecimal() else ""
