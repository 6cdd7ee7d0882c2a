"""How the threads of this process are scheduled, kept as it was."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from collections.abc import Iterator
from pathlib import Path

_TASKS = Path("/proc/self/task")


@contextlib.contextmanager
def kept_scheduling() -> Iterator[None]:
    """Undo what a library does to the scheduling of threads, also where it fails.

    SVT-AV1, where it may (run by root, say), puts its threads and its caller's at the head of everything that runs on
    the machine, for ever: an export would starve the loop of a robot.
    """
    if not _TASKS.exists():  # no Linux
        yield
        return
    me = threading.get_native_id()
    before, own = _all(), _of(me)
    try:
        yield
    finally:
        for thread, now in _all().items():
            wanted = before.get(thread, own)
            with contextlib.suppress(ProcessLookupError, PermissionError):  # it ended; or nobody could have raised it
                if now != wanted:
                    _put_back(thread, wanted) if thread != me else _put_own_back(wanted)


def _all() -> dict[int, tuple[int, int]]:
    """Return policy and priority of every thread that there is."""
    found = {}
    for task in _TASKS.iterdir():
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            found[int(task.name)] = _of(int(task.name))
    return found


def _of(thread: int) -> tuple[int, int]:
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def _put_back(thread: int, wanted: tuple[int, int]) -> None:
    policy, priority = wanted
    os.sched_setscheduler(thread, policy, os.sched_param(priority))


def _put_own_back(wanted: tuple[int, int]) -> None:
    """Put the calling thread's scheduling back where its C library has kept it as well.

    What `pthread_setschedparam` set, glibc keeps beside the thread, hands on to each thread that it starts, and answers
    `pthread_getschedparam` with; the kernel's own call would leave that copy as it is.
    """
    policy, priority = wanted
    library = ctypes.CDLL(None)
    library.pthread_self.restype = ctypes.c_ulong
    library.pthread_setschedparam.argtypes = [ctypes.c_ulong, ctypes.c_int, ctypes.POINTER(ctypes.c_int)]
    error = library.pthread_setschedparam(library.pthread_self(), policy, ctypes.byref(ctypes.c_int(priority)))
    if error:
        raise OSError(error, os.strerror(error))
