"""Figures of proofs: measured by the tier `proof`, written into the documentation by ``make prove``."""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/reliability.md"
BEGIN, END = "<!-- figures of `make prove`: begin -->", "<!-- figures of `make prove`: end -->"


class Figure(NamedTuple):
    """One measured figure."""

    what: str
    value: str
    limit: str
    test: str


class Figures:
    """What the proofs of this run measured; a test adds to it by ``proof.figure(…)``."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._folder = Path(config.cache.mkdir("figures")) if config.cache is not None else None

    def figure(self, what: str, value: float | str, unit: str = "", limit: str = "") -> None:
        """Keep a figure.

        Args:
            what: What was measured, as a row of a table says it.
            value: A number is written with three digits.
            unit: Of the value.
            limit: What is promised, with its unit.
        """
        test = str(self._config.stash.get(TEST, ""))
        text = f"{value:.3g}" if isinstance(value, float) else str(value)
        made = Figure(what, f"{text} {unit}".strip(), limit, test)
        if self._folder is not None:
            name = "".join(letter if letter.isalnum() else "-" for letter in what)[:80]
            (self._folder / f"{name}.json").write_text(json.dumps(made._asdict()))


TEST = pytest.StashKey[str]()


def written(config: pytest.Config) -> list[Figure]:
    """Return all figures that were kept in this checkout, by what they say."""
    if config.cache is None:
        return []
    found = [Figure(**json.loads(path.read_text())) for path in Path(config.cache.mkdir("figures")).glob("*.json")]
    return sorted(found)


def _file(figure: Figure) -> str:
    return figure.test.partition("::")[0]


def _table(file: str, figures: list[Figure]) -> str:
    rows = [f"| {row.what} | {row.value} | {row.limit} |" for row in figures]
    return "\n".join([f"| `{file}` | measured | promised |", "|---|---|---|", *rows])


def write_page(figures: list[Figure], page: Path = PAGE) -> None:
    """Write the figures into a page, a table for each file of tests; that of a file without figures stays."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    old, _, after = rest.partition(END)
    tables = {text.split("`")[1]: text for text in old.strip().split("\n\n") if text}
    tables |= {file: _table(file, list(rows)) for file, rows in groupby(sorted(figures, key=_file), _file)}
    kept = [table for file, table in sorted(tables.items()) if (ROOT / file).is_file()]
    page.write_text("\n".join([before + BEGIN, "\n\n".join(kept), END + after]), encoding="utf-8")
