"""Python processes that we start: they import what is installed, never what lies in the folder where they start, and
leave the processors to each other."""

from __future__ import annotations

import os
import sys

SAFE_PATH = "PYTHONSAFEPATH"
"""Python's own variable: set, ``python -m`` and ``python -c`` do not look for modules in the current folder."""
BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""NumPy's own: how many threads multiply matrices."""


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
