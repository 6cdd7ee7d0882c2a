"""Tiers of the suite: which tests run when. What a test uses decides, by its fixtures; no test is marked by hand.

========= =========================== ==============================================================
tier      fixture that decides        a test in it
========= =========================== ==============================================================
`proof`   `proof`                     measures a promise in milliseconds, or breaks things for minutes
`build`   `compiler`, `built_wheel`   compiles, or builds what is installed
`station` `processes`                 starts real processes; a bus server is one
`unit`    none of these               starts no process and waits for no clock
========= =========================== ==============================================================
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest

DECIDES = {"proof": "proof", "compiler": "build", "built_wheel": "build", "processes": "station"}
"""Tier that a fixture puts a test into, the strongest first."""

LONGEST_SLEEP_S = 0.1
"""Of a unit test: a thread may be given a moment, time is not waited for [s]."""

ROOT = Path(__file__).parents[1]
BUILT_FROM = (
    "bridges/kord", "bridges/g1_guard", "tests/bridges", "tests/network_link", "adapters/robots/g1", "pyproject.toml",
    "tests/test_wheel.py",
)  # fmt: skip

_PROCESS_EVENTS = ("subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn")
_ASKED_BY_LIBRARIES = ("fc-list",)  # matplotlib, once in a run
_limits = {"is_unit": False}  # of the test that runs now


class NotInItsTier(AssertionError):
    """A test did what its tier rules out."""


def tier_of(fixtures: set[str]) -> str:
    """Return the tier of a test from the names of all fixtures that it uses, directly or not."""
    return next((tier for fixture, tier in DECIDES.items() if fixture in fixtures), "unit")


def mark(items: list[pytest.Item]) -> None:
    """Mark each test with its tier; those that wait come first, so that short ones fill the gaps at the end."""
    for item in items:
        item.add_marker(tier_of(set(getattr(item, "fixturenames", ()))))
    order = ("build", "proof", "station", "unit")
    items.sort(key=lambda item: next(place for place, tier in enumerate(order) if item.get_closest_marker(tier)))


@contextmanager
def held_to(item: pytest.Item) -> Iterator[None]:
    """Hold a test to its tier for the length of a block."""
    _limits["is_unit"] = item.get_closest_marker("unit") is not None
    try:
        yield
    finally:
        _limits["is_unit"] = False


def watch() -> None:
    """From now on fail a unit test that starts a process or sleeps."""
    sys.addaudithook(_on_audit)
    sleep = time.sleep

    def short_sleep(seconds: float) -> None:
        if _limits["is_unit"] and seconds > LONGEST_SLEEP_S:
            raise NotInItsTier(f"a unit test sleeps for {seconds:g} s: give time as a number, or use `processes`")
        sleep(seconds)

    time.sleep = short_sleep
    start = BaseProcess.start  # of `multiprocessing`, which has no audit event

    def no_start(process: BaseProcess) -> None:
        _refuse_process(f"multiprocessing {process.name}")
        start(process)

    BaseProcess.start = no_start  # type: ignore[method-assign]


def _on_audit(event: str, arguments: tuple[Any, ...]) -> None:
    if not _limits["is_unit"] or event not in _PROCESS_EVENTS:
        return
    if not (arguments and arguments[0] in _ASKED_BY_LIBRARIES) and not _is_imported():
        what = " ".join(str(word) for word in list(arguments[1])[:4]) if event == "subprocess.Popen" else event
        _refuse_process(what)


def _is_imported() -> bool:
    """Whether a module is being imported: MuJoCo's asks for a version in a process, in whichever test comes first."""
    frame = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


def _refuse_process(what: str) -> None:
    if _limits["is_unit"]:
        raise NotInItsTier(f"a unit test starts a process ({what}): let it use the fixture `processes`")


def sources_hash() -> str:
    """Return a hash of what the tests of the build tier build, and of the compiler."""
    found = hashlib.sha256()
    every = [path for name in BUILT_FROM for path in (ROOT / name, *(ROOT / name).rglob("*")) if path.is_file()]
    for path in sorted(every):
        if "__pycache__" not in path.parts and "build" not in path.parts:
            found.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    if (compiler := shutil.which("c++")) is not None:
        found.update(subprocess.run([compiler, "--version"], capture_output=True, check=False).stdout)
    return found.hexdigest()


def is_built(config: pytest.Config) -> bool:
    """Whether the build tier was green with the sources and the compiler that are here."""
    return config.cache is not None and config.cache.get("station/built", "") == sources_hash()


def built(config: pytest.Config) -> None:
    """Remember that the build tier is green with what is here."""
    if config.cache is not None:
        config.cache.set("station/built", sources_hash())
