"""A fake stands in for hardware, which other work on this machine does not hold up."""

from __future__ import annotations

import contextlib
import os

_PRIORITY = 10  # below the station's own servers


def be_punctual() -> None:
    """Put the calling thread before all ordinary work, where that is permitted."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
