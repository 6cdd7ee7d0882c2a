"""Python processes that we start import what is installed, never what lies in the folder that they are started in."""

from __future__ import annotations

import os
import sys

SAFE_PATH = "PYTHONSAFEPATH"
"""Python's own variable: set, ``python -m`` and ``python -c`` do not look for modules in the current folder."""


def command(*arguments: str) -> list[str]:
    """Return the command line of a Python process with this interpreter."""
    return [sys.executable, "-P", *arguments]


def protect_children() -> None:
    """Protect every Python process that this one and its descendants start, multiprocessing's included."""
    os.environ[SAFE_PATH] = "1"
