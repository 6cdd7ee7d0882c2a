"""A benchmark that takes half a minute even when it is quick: its figures are of what its rows say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.benchmarks.test_benchmarks import run

pytestmark = [pytest.mark.usefixtures("processes"), pytest.mark.timeout(300)]


def test_a_quick_run_of_export_gives_figures_of_many_episodes_and_of_both_speeds(proof: object, tmp_path: Path) -> None:
    page = tmp_path / "performance.md"
    result = run("export", "--quick", "--write", "--page", str(page))
    assert result.returncode == 0, result.stderr
    lines = [line for line in page.read_text().splitlines() if line.startswith(("| many", "| speed"))]
    cells = {what: rest for what, *rest in (re.split(r" *\| *", line.strip("| ")) for line in lines)}
    compared = ("many: an episode, the last 10 of 40", "many: memory after the last", "speed without pictures",
                "speed with a camera")  # fmt: skip
    ratios = {what: _number(cells[what][3]) for what in compared}
    assert all(ratio > 0 for ratio in ratios.values()), ratios
    assert ratios["many: memory after the last"] < 1.5
    for what in ("many: joining 40 episodes, each", "many: robot time converted, one process"):
        assert _number(cells[what][0]) > 0


def _number(cell: str) -> float:
    return float(cell.split(maxsplit=1)[0])
