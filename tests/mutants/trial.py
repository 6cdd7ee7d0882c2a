"""Trials of mutants: a selection of tests must pass in a copy of the tree, and fail in one with the patch."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec

from tests.mutants.mutant import LINT_IMPORTS, Mutant

NOT_COPIED = shutil.ignore_patterns(
    ".git", ".venv", ".*_cache", "__pycache__", ".hypothesis", "build", "data", "soak", "*.egg-info"
)
LIMIT_S = 300.0  # for the tests of one mutant; a test has a limit of its own, see pyproject.toml
STOP_S = 20.0
CLEAN_LIMIT_S = 1200.0  # for all tests without a patch
TEST = re.compile(r"^(PASSED|FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
BROKEN = re.compile(r"^(.+) BROKEN", re.MULTILINE)

Outcome = Literal["caught", "survived", "stale", "error"]


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a mutant.

    Attributes:
        outcome: `error` where the trial says nothing: the tests fail without the patch, or cannot be run with it.
        told: The test that noticed, or why not.
        took_s: Time of the trial in [s].
    """

    mutant: Mutant
    outcome: Outcome
    told: str
    took_s: float = 0.0


class Bench:
    """A folder with a clean copy of the tree at `root`, and copies of that for one patch each.

    All of it may be used from several threads; `stop` ends what runs.
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self._folder, self._clean = folder, folder / "clean"
        shutil.copytree(root, self._clean, ignore=NOT_COPIED, symlinks=True)
        self._packages = [".", *_lend_compiled(self._clean)]
        self._why_not: dict[str, str] = {}  # by what catches mutants, where it is of no use
        self._lock, self._running, self._stopped = threading.Lock(), set[subprocess.Popen[str]](), False

    def run_clean(self, catchers: Sequence[str]) -> None:
        """Run what is to catch mutants without a patch: all of it has to pass, or its mutants are not tried."""
        if LINT_IMPORTS in catchers:
            code, said = self._run((LINT_IMPORTS,), self._clean)
            if code:
                self._why_not[LINT_IMPORTS] = f"{LINT_IMPORTS} finds broken contracts without the patch: {_last(said)}"
        tests = [name for name in catchers if name != LINT_IMPORTS]
        if not tests:
            return
        _, said = self._run(tests, self._clean, "-rfEp", limit_s=CLEAN_LIMIT_S)
        found = [(outcome, node) for outcome, node in TEST.findall(said)]
        for name in tests:
            own = [
                (outcome, node) for outcome, node in found if node == name or node.startswith((f"{name}::", f"{name}["))
            ]
            bad = next((node for outcome, node in own if outcome != "PASSED"), None)
            if bad is not None:
                self._why_not[name] = f"{bad} fails without the patch"
            elif not own:
                self._why_not[name] = f"no test of {name} passes without the patch: {_last(said)}"

    def try_mutant(self, mutant: Mutant) -> Verdict:
        """Say whether the mutant's tests notice it; after `run_clean`."""
        began_s = time.monotonic()
        if stale := mutant.why_stale(self._clean):
            return Verdict(mutant=mutant, outcome="stale", told=stale)
        if why_not := next((self._why_not[name] for name in mutant.caught_by if name in self._why_not), ""):
            return Verdict(mutant=mutant, outcome="error", told=why_not)
        tree = self._folder / mutant.name
        # Links are made in no time, and compiled modules beside them stay valid. Python and the patch write new files.
        shutil.copytree(self._clean, tree, copy_function=os.link, symlinks=True)
        mutant.apply(tree)
        code, said = self._run(mutant.caught_by, tree, "-x", "-rfE")
        shutil.rmtree(tree, ignore_errors=True)
        outcome, told = _judge(mutant, code, said)
        return Verdict(mutant=mutant, outcome=outcome, told=told, took_s=time.monotonic() - began_s)

    def stop(self) -> None:
        """End the tests that run now, and let no other begin."""
        with self._lock:
            self._stopped = True
            running = list(self._running)
        for process in running:
            _signal(process, signal.SIGINT)  # a test ends its own children
        for process in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(STOP_S)
            _signal(process, signal.SIGKILL)

    def _run(self, catchers: Sequence[str], tree: Path, *options: str, limit_s: float = LIMIT_S) -> tuple[int, str]:
        """Run tests in a tree, with its own packages in every child process; return exit code and output."""
        if LINT_IMPORTS in catchers:
            run = "from importlinter.cli import lint_imports_command as run; run()"
            command = [sys.executable, "-c", run, "--no-logo", "--no-cache"]
        else:
            command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, *catchers]
        path = os.pathsep.join(str(tree / folder) for folder in self._packages)
        environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "1000", "NO_COLOR": "1"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # what the clean copy has compiled serves all others
        with self._lock:
            if self._stopped:
                return 130, "stopped"
            process = subprocess.Popen(
                command, cwd=tree, env=environment, text=True, start_new_session=True,
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            )  # fmt: skip
            self._running.add(process)
        try:
            said, _ = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            _signal(process, signal.SIGKILL)
            said = process.communicate()[0] + f"\nnot done after {limit_s:g} s"
        finally:
            with self._lock:
                self._running.discard(process)
        return process.returncode, said


def _lend_compiled(tree: Path) -> list[str]:
    """Put the installed compiled half of bridges/kord beside the Python half of a copy; return where that is now.

    So a mutant of the Python half needs no compiler. One of the C++ half would, and there is none.
    """
    installed, place = importlib.util.find_spec("station_kord"), tree / "bridges/kord/station_kord"
    if installed is None or installed.origin is None or not place.is_dir():
        return []
    for compiled in Path(installed.origin).parent.glob("_native.*.so"):
        shutil.copy2(compiled, place)
    return ["bridges/kord"]


def _judge(mutant: Mutant, code: int, said: str) -> tuple[Outcome, str]:
    """Return what the output of a mutant's tests means."""
    if code == 0:
        return "survived", f"{' '.join(mutant.caught_by)} did not notice: {mutant.why}"
    if LINT_IMPORTS in mutant.caught_by:
        noticed = [match[1] for match in BROKEN.finditer(said)]
    else:
        noticed = [match[2] for match in TEST.finditer(said)]
    if code != 1 or not noticed:
        return "error", f"the tests did not run with the patch (exit code {code}): {_last(said)}"
    return "caught", noticed[0]


def _signal(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Send a signal to a process and its children, which are a session of their own."""
    if process.poll() is None:
        os.killpg(process.pid, number)


def _last(said: str) -> str:
    return next((line for line in reversed(said.splitlines()) if line.strip()), "no output")
