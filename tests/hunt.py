"""Hunt for tests that fail now and then: ``python -m tests.hunt --runs 20`` runs a tier beside a load, again and again.

Two processes spin, one writes and syncs a file. What failed is listed with how often, the longest time that each slow
test took, and where the output of each failed run is.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

SPIN = "while True: pass"
WRITE = """
import os, sys
with open(sys.argv[1], "wb") as file:
    while True:
        file.seek(0); file.write(os.urandom(1 << 20)); file.flush(); os.fsync(file.fileno())
"""
SLOWEST = 10


class Tally:
    """What became of each test in all runs so far."""

    def __init__(self) -> None:
        self.failures: Counter[str] = Counter()
        self.slowest_s: defaultdict[str, float] = defaultdict(float)
        self.logs: dict[str, Path] = {}
        self.runs = 0

    def add(self, report: Path, log: Path) -> int:
        """Add a run by its JUnit report; return how many tests failed in it."""
        self.runs += 1
        failed = 0
        for case in ElementTree.parse(report).getroot().iter("testcase"):
            name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
            self.slowest_s[name] = max(self.slowest_s[name], float(case.get("time", 0)))
            if case.find("failure") is not None or case.find("error") is not None:
                self.failures[name] += 1
                self.logs[name] = log
                failed += 1
        return failed

    def table(self) -> str:
        """Return what failed how often, and what took longest."""
        failed = self.failures.most_common()
        rows = [f"{count:3d} of {self.runs}  {name}  ({self.logs[name]})" for name, count in failed]
        slow = sorted(self.slowest_s.items(), key=lambda item: -item[1])[:SLOWEST]
        head = f"{sum(self.failures.values())} failures in {self.runs} runs of {len(self.slowest_s)} tests"
        return "\n".join([head, *rows, "slowest:"] + [f"{seconds:6.1f} s  {name}" for name, seconds in slow])


@contextlib.contextmanager
def load(folder: Path) -> Iterator[None]:
    """Two processes that spin and one that writes, for the length of a block."""
    commands = [["-c", SPIN], ["-c", SPIN], ["-c", WRITE, str(folder / "written")]]
    with contextlib.ExitStack() as running:
        for command in commands:
            process = subprocess.Popen([sys.executable, "-I", "-S", *command])
            running.callback(process.wait)
            running.callback(process.kill)
        yield


def main() -> int:
    """Run the hunt; return 1 when a test failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.hunt", description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="of the tier (default: %(default)s)")
    parser.add_argument("--tier", default="station", help="or an expression of tiers (default: %(default)s)")
    parser.add_argument(
        "--jobs", default="6", help="processes that run tests; they wait more than they work (default: %(default)s)"
    )
    parser.add_argument("--idle", action="store_true", help="without the load beside it")
    parser.add_argument("selection", nargs="*", help="files or tests (default: all)")
    asked = parser.parse_args()
    folder, tally = Path(tempfile.mkdtemp(prefix="hunt-")), Tally()
    print(f"output of each run: {folder}", flush=True)
    with contextlib.nullcontext() if asked.idle else load(folder):
        try:
            for number in range(1, asked.runs + 1):
                _run(folder / f"{number}", asked, tally)
        except KeyboardInterrupt:
            print("interrupted", flush=True)
    print(tally.table(), flush=True)
    return 1 if tally.failures or not tally.runs else 0


def _run(place: Path, asked: argparse.Namespace, tally: Tally) -> None:
    log, report, began_s = place.with_suffix(".log"), place.with_suffix(".xml"), time.monotonic()
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-m",
        asked.tier,
        "-n",
        asked.jobs,
        "--dist",
        "loadscope",
        "--new-examples",
    ]
    with log.open("wb") as output:
        done = subprocess.run(
            [*command, f"--junitxml={report}", "-p", "no:cacheprovider", *asked.selection],
            stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, check=False, env=dict(os.environ),
        )  # fmt: skip
    if not report.exists():
        raise SystemExit(f"pytest ended with {done.returncode} and no report; its output: {log}")
    failed = tally.add(report, log)
    print(f"run {tally.runs}: {failed} failed, {(time.monotonic() - began_s) / 60:.1f} min", flush=True)


if __name__ == "__main__":
    sys.exit(main())
