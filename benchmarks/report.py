"""Tables: in a terminal, and as the page ``docs/performance.md``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import machine
from benchmarks.harness import Benchmark, Row

PAGE = Path(__file__).resolve().parent.parent / "docs" / "performance.md"
_COLUMNS = ("quantity", "ours", "baseline", "its figure", "ours / baseline", "target", "verdict")

_HEAD = """\
# Performance

Written by `python -m benchmarks --write`; do not edit. Every figure stands beside a baseline that was measured in the
same run, the two taking turns: **carry the ratios to another machine, not the absolutes**. A figure is the median over
the rounds, a p99 the median of the rounds' 99th percentiles. The stock pattern is re-created in `benchmarks/stock.py`.
Targets: of the figure, or of the ratio where they end in "x". *Quiet* means that the benchmark adds no load of its own;
on a shared machine the tails of rows without FIFO show its other users too.
"""


def show(benchmark: Benchmark, rows: Sequence[Row], console: Console) -> None:
    """Print one benchmark's table."""
    table = Table(*_COLUMNS, title=benchmark.title, title_justify="left", title_style="bold")
    for row in rows:
        table.add_row(*_cells(row), style="red" if row.verdict == "not met" else None)
    console.print(table)


def write(page: Path, sections: dict[str, str], order: Sequence[str]) -> None:
    """Write the page; what it says of benchmarks that did not run stays."""
    page.parent.mkdir(parents=True, exist_ok=True)
    kept = _sections(page.read_text()) if page.exists() else {}
    kept |= sections
    body = "\n\n".join(kept[name].strip() for name in order if name in kept)
    page.write_text(f"{_HEAD}\n{body}\n")


def section(benchmark: Benchmark, rows: Sequence[Row], command: str) -> str:
    """Return what the page says of one benchmark."""
    lines = [f"<!-- {benchmark.name} -->", f"## {benchmark.title}", "", benchmark.method, ""]
    lines += [f"| {' | '.join(_COLUMNS)} |", f"|{' --- |' * len(_COLUMNS)}"]
    lines += [f"| {' | '.join(_cells(row))} |" for row in rows]
    lines += ["", f"`{command}`, {machine.today()}, on {'; '.join(machine.describe())}.", ""]
    return "\n".join(lines)


def _sections(text: str) -> dict[str, str]:
    parts = re.split(r"^(?=<!-- [\w-]+ -->$)", text, flags=re.MULTILINE)[1:]
    return {part[5 : part.index(" -->")]: part for part in parts}


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.what,
        f"{_number(row.ours)} {row.unit}",
        row.baseline,
        "" if row.theirs is None else f"{_number(row.theirs)} {row.unit}",
        "" if row.ratio is None else f"{_number(row.ratio)} x",
        _target(row),
        row.verdict,
    )


def _target(row: Row) -> str:
    if row.target is None:
        return ""
    sign = {"<=": "≤", ">=": "≥"}[row.target.sense]
    return f"{sign} {row.target.limit:g} {row.unit if row.target.of == 'figure' else 'x'}"


def _number(value: float) -> str:
    """Three digits that mean something."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
