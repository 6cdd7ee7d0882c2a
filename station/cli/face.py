"""How a session shows itself in a terminal: a line per step, and a live footer where there is a screen."""

from __future__ import annotations

import sys
import time
from types import TracebackType

import click
from rich.console import Console
from rich.live import Live

from station.life.server import Health
from station.view.table import render_servers

_SHOW_S = 0.25


class TerminalFace:
    """Prints steps and events to stderr, and keeps a table of the servers below them on a real terminal."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._live: Live | None = None
        self._shown_s = 0.0

    def __enter__(self) -> TerminalFace:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end_live()

    def begin(self, step: str) -> None:
        """Say what is being done, where a slow step would otherwise leave a person wondering."""
        if self._console.is_terminal:
            self._console.print(
                f"[dim]…[/] {_plain(step)}", end="\r", soft_wrap=False, overflow="ellipsis", no_wrap=True
            )

    def done(self, step: str, result: str) -> None:
        """Print a finished step and its result."""
        self._end_live()
        self._console.print(f"[green]✓[/] {_plain(step)}\n  [dim]{_plain(result)}[/]", soft_wrap=True)

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(f"[cyan]·[/] {_plain(text)}", soft_wrap=True)

    def confirm(self, sentence: str) -> bool:
        """Ask a person; a terminal without one counts as no."""
        self._end_live()
        if not sys.stdin.isatty():
            self._console.print(
                f"? {_plain(sentence)} — nobody is here to answer; use --yes in simulation", soft_wrap=True
            )
            return False
        return click.confirm(f"? {sentence}", default=False, err=True)

    def show(self, health: list[Health]) -> None:
        """Refresh the table."""
        now_s = time.monotonic()
        if not self._console.is_terminal or now_s - self._shown_s < _SHOW_S:
            return
        self._shown_s = now_s
        if self._live is None:
            self._live = Live(console=self._console, transient=True, auto_refresh=False)
            self._live.start()
        self._live.update(render_servers(health), refresh=True)

    def _end_live(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None


def _plain(text: str) -> str:
    return text.replace("[", r"\[")
