"""Sound episodes of all kinds of runbooks, made beside busy loops: whatever is said of them may be a false alarm."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path

from tests.corruption import stations
from tests.corruption.judging import judge


def run(count: int, work: Path) -> int:
    """Make and judge so many; those that are there from an earlier run are only judged. Return 1 if one is not good."""
    alarms = []
    with _busy_loops():
        for number, kind in enumerate(islice(cycle(stations.SOUND), count), 1):
            folder = work / "sound" / f"{number:03d}-{kind.name}"
            try:
                if not (folder / "manifest.yaml").exists():
                    stations.record(kind, folder)
            except RuntimeError as error:
                _print(f"{number:3} {kind.name:<12} NOT RECORDED: {error}\n")
                alarms.append(f"{kind.name}: not recorded")
                continue
            found = judge(folder)
            _print(f"{number:3} {kind.name:<12} {found.verdict:<8} audit: {found.audit}\n")
            for reason in found.reasons:
                _print(f"      {reason['verdict']} {reason['rule']}: {reason['text']}\n")
            alarms += [f"{kind.name}: {reason['rule']}" for reason in found.reasons]
    _print(f"{count} sound episodes beside {_loops()} busy loops on {os.cpu_count()} cores: {len(alarms)} reasons\n")
    return 1 if alarms else 0


def _loops() -> int:
    return os.cpu_count() or 1


@contextlib.contextmanager
def _busy_loops() -> Iterator[None]:
    """Keep every core busy, at the priority of anybody's program."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(_loops())]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def _print(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()
