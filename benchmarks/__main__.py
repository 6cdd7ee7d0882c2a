"""``python -m benchmarks [NAME…] [--quick] [--write]``: measure, and print a table."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from benchmarks import report, upstream
from benchmarks.harness import Benchmark, Settings
from station.errors import did_you_mean

MODULES = (
    "bus", "wake", "bulk", "loop", "estop", "recorder", "effect", "sim", "inference", "legged", "devices", "camera",
    "retarget", "walking", "reading", "export", "startup", "whole", "kord", "dds",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run benchmarks; return 0 when each could be measured, whether or not a target was met."""
    parser = _parser()
    options = parser.parse_args(arguments)
    for name in options.names:
        if name not in MODULES:
            parser.error(f"no benchmark {name!r}{did_you_mean(name, MODULES)}; there are {', '.join(MODULES)}")
    settings = Settings(quick=options.quick, minutes=options.minutes)
    console, sections = Console(width=options.width), {}
    chosen = [*(["--quick"] if options.quick else []), *([f"--minutes {options.minutes:g}"] if options.minutes else [])]
    command = " ".join(["python -m benchmarks", *options.names, *chosen])
    for name in options.names or MODULES:
        try:
            benchmark: Benchmark = importlib.import_module(f"benchmarks.{name}").BENCHMARK
        except ModuleNotFoundError as error:
            parser.error(
                f"benchmark {name} needs {error.name}, for its baseline; install it with: pip install -e .[test]"
            )
        if benchmark.needs_assets and (problem := upstream.problem()):
            console.print(f"{benchmark.title}: left out, needs upstream data: {problem}")
            continue
        rows = benchmark.run(settings)
        report.show(benchmark, rows, console)
        sections[name] = report.section(benchmark, rows, command)
        if options.write:  # after each one, so that a run that is cut short keeps what it has
            report.write(options.page, sections, MODULES)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME",
                        help=f"what to measure: {', '.join(MODULES)}; all by default")  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="show that everything works; the figures mean little")
    parser.add_argument("--minutes", type=float, default=0.0, metavar="N",
                        help="also run the recorder for so long, to see whether its memory grows")  # fmt: skip
    parser.add_argument("--write", action="store_true", help="write the tables into docs/performance.md")
    parser.add_argument("--page", type=Path, default=report.PAGE, help=argparse.SUPPRESS)
    parser.add_argument("--width", type=int, default=None, help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
