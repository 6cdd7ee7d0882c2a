"""What a test leaves behind, and what there is to see when it fails."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
from collections.abc import Iterator
from multiprocessing import resource_tracker
from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.errors import BusError
from tests.waiting import wait_until
from tests.warm.starts import LASTING

ROOT = Path(__file__).parents[1]
_ALL = "all of them"
LINES = 40
"""Of each log in the report of a failure, the last."""
KEYS = 100
"""Of the bus, at most."""

SHARED: set[str] = set()
"""Fixtures of a class, module or package that are set up now: what they started outlives a test."""

_LOGS = ("*.log", "*.err", "*.stderr", "*words*", "manifest.yaml")
_GOING_S = 20.0  # a child that was told to go may take so long
_KNOWN = frozenset({".pytest_cache", ".mypy_cache", ".ruff_cache", "__pycache__", ".hypothesis", ".benchmarks"})


@contextlib.contextmanager
def none_left() -> Iterator[None]:
    """Fail the test whose length this block has when it leaves processes, real-time scheduling, or silent loggers.

    A process of a fixture that several tests share may stay.
    """
    children, loggers = _children(), _loggers()
    yield
    found = []
    if (levels := _loggers()) != loggers:
        found.append(f"levels of loggers: {levels}, before it {loggers}")
        logging.disable(loggers.pop(_ALL))
        for name, level in loggers.items():
            logging.getLogger(name).setLevel(level)
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_OTHER:
        found.append(f"real-time scheduling (policy {os.sched_getscheduler(0)})")
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if not SHARED:
        left: dict[int, str] = {}

        def are_gone() -> bool:
            left.clear()
            left.update({pid: name for pid, name in _children().items() if pid not in children})
            return not left

        try:
            wait_until(are_gone, _GOING_S)
        except AssertionError:
            found.append("processes: " + ", ".join(f"{pid} ({name})" for pid, name in left.items()))
            for pid in left:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
    if found:
        pytest.fail(f"the test leaves behind {'; '.join(found)}")


def evidence(item: pytest.Item) -> list[tuple[str, str]]:
    """Return what helps to understand a failure: the ends of all logs of the test, and what is on its bus."""
    arguments = getattr(item, "funcargs", {})
    folders = [value for value in arguments.values() if isinstance(value, Path) and value.is_dir()]
    if runtime := os.environ.get("XDG_RUNTIME_DIR"):
        folders.append(Path(runtime))
    home = getattr(arguments.get("home"), "environment", {}).get("XDG_RUNTIME_DIR")
    folders += [Path(home)] if home else []
    logs = {path for folder in folders if folder != ROOT for pattern in _LOGS for path in folder.rglob(pattern)}
    sections = [(f"log {path}", _end_of(path)) for path in sorted(logs) if path.is_file()]
    for name, value in arguments.items():
        if isinstance(value, BusAddress):
            sections.append((f"keys of the bus {name}", _keys_of(value)))
    return [(title, text) for title, text in sections if text]


def _children() -> dict[int, str]:
    """Return the processes that have been started from here, but for those that are to last: id and name."""
    found: dict[int, str] = {}
    tracker = getattr(resource_tracker, "_resource_tracker")._pid  # noqa: B009  of the standard library, for a run
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            for pid in {*map(int, (task / "children").read_text().split())} - LASTING - {tracker}:
                with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                    found[pid] = Path(f"/proc/{pid}/comm").read_text().strip()
    return found


def _loggers() -> dict[str, int]:
    """Return the levels that decide what is logged of the station."""
    return {name: logging.getLogger(name).level for name in ("root", "station")} | {_ALL: logging.root.manager.disable}


def files_in_checkout() -> set[str]:
    """Return the names of what lies in the checkout, but for caches of tools."""
    return {path.name for path in ROOT.iterdir()} - _KNOWN


def _end_of(path: Path) -> str:
    with contextlib.suppress(OSError):
        lines = path.read_text(errors="replace").splitlines()
        return "\n".join(lines[-LINES:])
    return ""


def _keys_of(address: BusAddress) -> str:
    try:
        with contextlib.closing(Connection(address, timeout_s=1.0)) as line:
            names = sorted(line.call("KEYS", "*"))[:KEYS]
            values = line.call("MGET", *names) if names else []
    except BusError as error:
        return f"it does not answer: {error}"
    return "\n".join(
        f"{name.decode(errors='replace')} = {bytes(value or b'')[:160]!r}"
        for name, value in zip(names, values, strict=True)
    )
