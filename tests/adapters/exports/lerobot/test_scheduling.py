"""Whatever a library did to the scheduling of threads is undone, for the kernel and for the C library."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from adapters.exports.lerobot.video import kept_scheduling

ROOT = Path(__file__).parents[4]
PRIORITY = 7

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="scheduling as Linux has it")


def raise_this_thread() -> None:
    """Ask for real time as SVT-AV1 does: through the C library."""
    library = ctypes.CDLL(None)
    library.pthread_self.restype = ctypes.c_ulong
    library.pthread_setschedparam.argtypes = [ctypes.c_ulong, ctypes.c_int, ctypes.POINTER(ctypes.c_int)]
    wanted = ctypes.byref(ctypes.c_int(PRIORITY))
    if error := library.pthread_setschedparam(library.pthread_self(), os.SCHED_FIFO, wanted):
        raise PermissionError(error, os.strerror(error))


def told_of_a_new_thread() -> tuple[int, int]:
    """Return policy and priority that the C library tells of a thread that is started now.

    It keeps what it answered once; so the calling thread is not asked, which would hand the answer on.
    """
    library, found = ctypes.CDLL(None), []
    library.pthread_self.restype = ctypes.c_ulong
    library.pthread_getschedparam.argtypes = [ctypes.c_ulong, *[ctypes.POINTER(ctypes.c_int)] * 2]

    def ask() -> None:
        policy, priority = ctypes.c_int(), ctypes.c_int()
        library.pthread_getschedparam(library.pthread_self(), ctypes.byref(policy), ctypes.byref(priority))
        found.append((policy.value, priority.value))

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    return found[0]


def kernel_tells() -> tuple[int, int]:
    return os.sched_getscheduler(0), os.sched_getparam(0).sched_priority


def alone(function: str) -> None:
    """Call a function of this module in a process of its own; skip where the system refuses it real time."""
    code = f"import {__name__} as test; test.{function}()"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    if "PermissionError" in done.stderr:
        pytest.skip("real-time scheduling is not permitted here")
    assert done.returncode == 0, done.stderr


def _raised_and_put_back() -> None:
    before = kernel_tells()
    with kept_scheduling():
        raise_this_thread()
        assert kernel_tells() == told_of_a_new_thread() == (os.SCHED_FIFO, PRIORITY)
    assert kernel_tells() == told_of_a_new_thread() == before


def _raised_by_one_that_fails() -> None:
    before = kernel_tells()
    with pytest.raises(RuntimeError, match="no such encoder"), kept_scheduling():
        _raise_and_fail()
    assert kernel_tells() == told_of_a_new_thread() == before


def _raise_and_fail() -> None:
    raise_this_thread()
    raise RuntimeError("no such encoder")


def _raised_threads_of_others() -> None:
    raised, over = threading.Event(), threading.Event()

    def other() -> None:
        raise_this_thread()
        raised.set()
        over.wait()

    before = kernel_tells()
    with kept_scheduling():
        thread = threading.Thread(target=other)
        thread.start()
        while not raised.wait(0.05):
            assert thread.is_alive(), "PermissionError"
    assert thread.native_id is not None
    assert (os.sched_getscheduler(thread.native_id), os.sched_getparam(thread.native_id).sched_priority) == before
    over.set()
    thread.join()


@pytest.mark.usefixtures("processes")
def test_a_thread_that_was_raised_is_told_as_before_and_so_are_those_it_starts() -> None:
    alone("_raised_and_put_back")


@pytest.mark.usefixtures("processes")
def test_scheduling_is_put_back_also_where_the_library_fails() -> None:
    alone("_raised_by_one_that_fails")


@pytest.mark.usefixtures("processes")
def test_threads_that_the_library_started_are_put_back_too() -> None:
    alone("_raised_threads_of_others")
