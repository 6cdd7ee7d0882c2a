"""Figures of a run of some proofs leave those of the others in the page."""

from __future__ import annotations

from pathlib import Path

from tests.figures import BEGIN, END, Figure, write_page

OTHERS = "| `tests/test_tiers.py` | measured | promised |\n|---|---|---|\n| a tier | 1 s | 2 s |"
GONE = "| `tests/test_nowhere.py` | measured | promised |\n|---|---|---|\n| nothing | 1 s | 2 s |"


def test_a_run_of_some_proofs_replaces_their_figures_alone(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\n{GONE}\n\n{OTHERS}\n{END}\nafter\n")
    write_page([], page)
    assert page.read_text() == f"before\n{BEGIN}\n{OTHERS}\n{END}\nafter\n"
    test = "tests/test_figures.py::test_one"
    for value in ("3 ms", "4 ms"):
        write_page([Figure("a delay", value, "5 ms", test)], page)
    own = "| `tests/test_figures.py` | measured | promised |\n|---|---|---|\n| a delay | 4 ms | 5 ms |"
    assert page.read_text() == f"before\n{BEGIN}\n{own}\n\n{OTHERS}\n{END}\nafter\n"
