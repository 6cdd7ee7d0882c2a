"""Plain tables that keep every cell whole: on a narrow screen a row is wider than the screen, never cut."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

from rich.console import Console
from rich.table import Table

from station.view.table import plain

__all__ = ["Column", "plain", "print_table", "wide_console"]

_WIDE = 200  # characters; a pipe or a file has no width
_WIDEST = 20_000  # of a row; one that does not fit would be cut, and a table takes no more room than it needs


class Column(NamedTuple):
    """Title and side of a column."""

    title: str
    side: Literal["left", "right"] = "right"


def wide_console() -> Console:
    """Return a console for stdout that is never narrower than a table."""
    return Console(highlight=False, width=max(Console().width, _WIDE), soft_wrap=True)


def print_table(columns: Sequence[Column], rows: Iterable[Sequence[str]], *, indent: int = 0) -> None:
    """Print rows below bold titles; cells may carry rich's colours."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column.title, justify=column.side, no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, width=_WIDEST, soft_wrap=True)
    if indent:
        from rich.padding import Padding

        console.print(Padding(table, (0, 0, 0, indent), expand=False))
    else:
        console.print(table)
