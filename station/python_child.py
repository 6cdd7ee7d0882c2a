"""Python processes that we start: they import what is installed, never what lies in the folder where they start, and
leave the processors to each other."""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SAFE_PATH = "PYTHONSAFEPATH"
"""Python's own variable: set, ``python -m`` and ``python -c`` do not look for modules in the current folder."""
BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""NumPy's own: how many threads multiply matrices."""

STACKS = signal.SIGUSR1
"""Asks a process that called `write_stacks_when_asked` where each of its threads stands."""


def command(*arguments: str) -> list[str]:
    """Return the command line of a Python process with this interpreter."""
    return [sys.executable, "-P", *arguments]


def protect_children() -> None:
    """Protect every Python process that this one and its descendants start, multiprocessing's included."""
    os.environ[SAFE_PATH] = "1"


def spare_processors() -> None:
    """Let NumPy multiply in the thread that asks, here and in every descendant; before NumPy is imported.

    It starts a thread for each further processor otherwise, which spin for a tenth of a second at the start of every
    process, beside the one that loads a policy or moves a robot. Our matrices are too small for two threads. What the
    user has set stays.
    """
    os.environ.setdefault(BLAS_THREADS, "1")


_keeps = {"imports": False}


def keep_imports() -> None:
    """From now on leave what is imported in `importing` out of each search for what can be freed: modules stay.

    Such searches, while it is imported and at the end again, are a quarter of what a short command costs. Only for a
    process of our own: what waits to be freed when something is imported stays as well.
    """
    _keeps["imports"] = True


@contextmanager
def importing() -> Iterator[None]:
    """Import what stays; without `keep_imports` as anywhere."""
    if not _keeps["imports"] or not gc.isenabled():
        yield
        return
    known = len(sys.modules)
    gc.disable()
    try:
        yield
    finally:
        if len(sys.modules) > known:
            gc.freeze()
        gc.enable()


def write_stacks_when_asked() -> None:
    """Have `STACKS` write to stderr where each thread stands, also where one waits for ever in a library's code."""
    faulthandler.register(STACKS, all_threads=True)


def writes_stacks(pid: int) -> bool:
    """Whether a process listens to `STACKS`; one that does not would be killed by it."""
    try:
        facts = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
    caught = next((line.split()[1] for line in facts.splitlines() if line.startswith("SigCgt:")), "0")
    return bool(int(caught, 16) >> (STACKS - 1) & 1)
