"""Waiting for conditions: deadlines far above the need, never a sleep that hopes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import BusError

DEADLINE_S = 60.0


def wait_until(condition: Callable[[], object], timeout_s: float = DEADLINE_S) -> None:
    """Return as soon as a condition holds; fail when it does not in time."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"did not hold within {timeout_s:g} s: {condition}")
        time.sleep(0.005)


def is_running(pid: int) -> bool:
    """Whether there is a process that has not ended; one that nobody has waited for has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # the second where it goes between opening and reading
        return False


def bus_answers(address: BusAddress) -> bool:
    """Whether there is a bus to work with; that its socket's file is there says nothing, for nobody may listen yet."""
    try:
        Bus(address, name="test").close()
    except BusError:
        return False
    return True
