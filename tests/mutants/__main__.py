"""``python -m tests.mutants``: patch a copy of the tree with each mutant, and see that its tests fail.

Prints a line per mutant as it is tried and a sum; the exit code is 1 where one survived, is stale or could not be
tried. A survivor means that the suite is blind there: write the test that is missing.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from tests.mutants.mutant import Mutant, load
from tests.mutants.trial import Bench, Verdict

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]


def main(arguments: Sequence[str] | None = None, root: Path = ROOT, folder: Path = FOLDER) -> int:
    """Try mutants of a folder on the tree at `root`; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description="Try small wrong patches.")
    parser.add_argument("--only", metavar="NAME", action="append", default=[], help="this mutant alone; may repeat")
    parser.add_argument("--list", action="store_true", help="print the mutants and try none")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="how many at a time (default: %(default)s)"
    )
    asked = parser.parse_args(arguments)
    mutants = load(folder)
    unknown = set(asked.only) - {mutant.name for mutant in mutants}
    if unknown:
        parser.error(f"there is no mutant {', '.join(sorted(unknown))}; --list shows all")
    chosen = [mutant for mutant in mutants if not asked.only or mutant.name in asked.only]
    if asked.list:
        for mutant in chosen:
            print(f"{mutant.name:<40} {mutant.file}\n    {mutant.why}")
        return 0
    try:
        return _try_all(chosen, root, max(1, asked.jobs))
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130


def _try_all(mutants: list[Mutant], root: Path, jobs: int) -> int:
    began_s = time.monotonic()
    outcomes: Counter[str] = Counter()
    catchers = sorted({name for mutant in mutants for name in mutant.caught_by})
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
        bench = Bench(root, Path(folder))
        with ThreadPoolExecutor(jobs) as pool:
            try:
                for done in [pool.submit(bench.run_clean, catchers[job::jobs]) for job in range(jobs)]:
                    done.result()
                print(f"{len(catchers)} tests and files run without a patch in {time.monotonic() - began_s:.0f} s")
                for trial in as_completed([pool.submit(bench.try_mutant, mutant) for mutant in mutants]):
                    outcomes[trial.result().outcome] += 1
                    _print(trial.result())
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                bench.stop()
                raise
    print(f"{outcomes['caught']} of {len(mutants)} caught in {time.monotonic() - began_s:.0f} s")
    return 0 if outcomes["caught"] == len(mutants) else 1


def _print(verdict: Verdict) -> None:
    outcome = "" if verdict.outcome == "caught" else f"{verdict.outcome.upper()}: "
    print(f"{verdict.mutant.name:<40} {verdict.took_s:6.1f} s  {outcome}{verdict.told}", flush=True)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # a shell's background job would ignore the first
        signal.signal(number, signal.default_int_handler)
    sys.exit(main())
