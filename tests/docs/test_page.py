"""What stands in a page is found, and what no longer holds is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.docs.page import Shown, Stale, compared, shown
from tests.docs.pages import PAGES, PLAYED_BY
from tests.tiers import ROOT

PAGE = """\
Words, and `station status` within them.

```
$ station check latest   # measured
walk-0001: good   11.4 s

  lost   0
$ station up demo --yes \\
      --task walk
$ python -c '
print(1)'
1
```

```yaml
station: demo
```

```
station down      # in order
2 of these lines are no commands
make test
```
"""
TABLE = ["name   size", "a     1.2 kB", "b   300 B", "", "2 files, sha256 0a1b2c3d4e5f"]


def test_commands_of_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    assert shown(page) == [
        Shown("station check latest", ["walk-0001: good   11.4 s", "", "  lost   0"], 4),
        Shown("station up demo --yes       --task walk", [], 9),
        Shown("python -c '\nprint(1)'", ["1"], 11),
        Shown("station down", [], 20),
        Shown("make test", [], 22),
    ]


@pytest.mark.parametrize(
    "told",
    [
        ["name size", "a 99 MB", "b 1 B", "1 files, sha256 ffffffff0"],
        ["…", "2 files, sha256 0a1b…"],
        ["name …", "…", "2 files, sha256 …"],
        ["name   size", "…"],
        ["…", "b   300 B", "…"],
        ["…"],
    ],
)
def test_numbers_hashes_and_widths_may_differ_and_much_be_left_out(told: list[str]) -> None:
    assert len(compared(told, TABLE)) == len(told)


@pytest.mark.parametrize(
    ("told", "why"),
    [
        (["name size", "…", "c 1 B", "…"], "no such line:\nc 1 B\nit said:"),
        (["name size", "a 1 kB", "b 1 B"], "not in this order, or amid other lines"),
        (["a 1 kB", "…"], "not in this order, or amid other lines"),
        (["…", "name size", "b 1 B", "…"], "not in this order, or amid other lines"),
        (["…", "b 300 B", "…", "a 1.2 kB", "…"], "not in this order, or amid other lines"),
        (["…", "0 files, sha256 …"], "no such line:\n0 files"),
        (["…", "b 300 B"], "not in this order, or amid other lines"),
    ],
)
def test_what_no_longer_holds_is_told(told: list[str], why: str) -> None:
    with pytest.raises(Stale) as error:
        compared(told, TABLE)
    assert str(error.value).startswith(why)


def test_what_was_drawn_over_may_be_shown_between_two_gaps() -> None:
    drawn = ["motion  0 s", "robot ok", "motion  1 s", "robot ok"]
    told = ["name size", "…", "motion  7 s", "robot ok", "…", "2 files, sha256 …"]
    assert compared(told, TABLE, drawn)[2] == "motion  0 s"
    with pytest.raises(Stale, match="no such line:\nrobot fell"):
        compared([*told[:3], "robot fell", *told[4:]], TABLE, drawn)


def test_a_page_gets_the_values_of_the_run(tmp_path: Path) -> None:
    told = ["name   size", "…", "", "9 files, sha256 …"]
    assert compared(told, TABLE) == ["name   size", "…", "", "2 files, sha256 …"]
    assert compared(["…", "run 1: 21 901 messages at …/a 0.1 ms"], ["x", "run 7: 5 messages at /tmp/b/a 11.25 ms"]) == [
        "…",
        "run 7: 5 messages at …/a 11.25 ms",
    ]


def test_each_page_with_commands_is_typed_or_played() -> None:
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    with_commands = {str(page.relative_to(ROOT)) for page in pages if shown(page)}
    assert with_commands == {*PAGES, *PLAYED_BY}
    assert not [test for test in PLAYED_BY.values() if not (ROOT / test).is_file()]
