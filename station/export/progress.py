"""How an export is going, for a person at a terminal: episodes done and failed, how fast, how long yet."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol


class ProgressListener(Protocol):
    """Hears of the episodes that are over."""

    def __call__(self, *, is_lost: bool = False) -> None:
        """One more is over; `is_lost`: it came to nothing."""


@dataclass
class _Bar:
    done: int = 0
    lost: int = 0


@contextmanager
def progress(total: int, what: str, *, is_quiet: bool = False) -> Iterator[ProgressListener]:
    """Show a line that moves, on stderr, where that is a terminal; a log or a pipe is told nothing.

    Args:
        total: Episodes.
        what: What is done with them, for example ``exporting``.
        is_quiet: Show nothing anywhere.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console, bar = Console(stderr=True), _Bar()
    columns = (
        TextColumn(what), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[lost]}", style="yellow"),
        TextColumn("{task.fields[rate]}"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=is_quiet or not console.is_terminal) as shown:
        task = shown.add_task(what, total=total, lost="", rate="")

        def update(*, is_lost: bool = False) -> None:
            bar.done += 1
            bar.lost += is_lost
            elapsed_s = shown.tasks[0].elapsed or 0.0
            rate = f"{bar.done / elapsed_s:.1f}/s" if elapsed_s > 0 else ""
            shown.update(task, completed=bar.done, lost=f"{bar.lost} left out" if bar.lost else "", rate=rate)

        yield update
