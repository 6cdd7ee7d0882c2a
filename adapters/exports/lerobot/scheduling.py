"""How the threads of this process are scheduled, kept as it was."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

_TASKS = Path("/proc/self/task")


@contextlib.contextmanager
def kept_scheduling() -> Iterator[None]:
    """Undo what a library does to the scheduling of threads.

    SVT-AV1, where it may (run by root, say), puts its threads and its caller's at the head of everything that runs on
    the machine, for ever: an export would starve the loop of a robot.
    """
    if not _TASKS.exists():  # no Linux
        yield
        return
    before, own = _all(), _of(threading.get_native_id())
    yield
    for thread, now in _all().items():
        policy, priority = before.get(thread, own)
        with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended; or nobody could have raised it
            if now != (policy, priority):
                os.sched_setscheduler(thread, policy, os.sched_param(priority))


def _all() -> dict[int, tuple[int, int]]:
    """Return policy and priority of every thread that there is."""
    found = {}
    for task in _TASKS.iterdir():
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            found[int(task.name)] = _of(int(task.name))
    return found


def _of(thread: int) -> tuple[int, int]:
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority
