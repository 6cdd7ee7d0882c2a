"""How a session shows itself in a terminal: a line per step, and a live footer where there is a screen."""

from __future__ import annotations

import logging
import select
import sys
import termios
import threading
import time
from types import TracebackType

import click
from rich.console import Console, RenderableType
from rich.live import Live
from rich.markup import escape

from station.life.events import Severity
from station.life.server import Health
from station.view.table import render_servers

_SHOW_S = 0.25
_LISTEN_S = 0.05
_LONGEST = 200  # characters of something that happened; the log and the episode have the rest
_MARKS: dict[Severity, str] = {"info": "[cyan]·[/]", "warning": "[yellow]![/]", "error": "[red]✗[/]"}


class TerminalFace:
    """Prints steps and events to stderr; a real terminal has a footer below them: the present step, or the servers.

    Args:
        stop: Ends a question without an answer when it is set.
    """

    def __init__(self, stop: threading.Event) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._stop = stop
        self._live: Live | None = None
        self._shown_s = 0.0
        self._log = _Log(self)
        self._handlers: list[logging.Handler] = []

    def __enter__(self) -> TerminalFace:
        root = logging.getLogger()
        self._handlers, root.handlers = root.handlers, [self._log]  # a bare line would tear the footer
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        logging.getLogger().handlers = self._handlers
        self._end_footer()

    def begin(self, step: str) -> None:
        """Show what is being done, where a slow step would otherwise leave a person wondering."""
        self._footer(f"[dim]… {escape(step)}[/]")

    def done(self, step: str, result: str) -> None:
        """Print a finished step and its result."""
        self._print(f"[green]✓[/] {escape(step)}  [dim]{escape(result)}[/]")

    def failed(self, step: str, reason: str) -> None:
        """Print a step that failed."""
        self._print(f"[red]✗[/] {escape(step)}  [red]{escape(reason)}[/]")

    def say(self, text: str, severity: Severity = "info") -> None:
        """Print a line."""
        shown = text if len(text) <= _LONGEST or severity != "info" else text[:_LONGEST] + "…"
        self._print(f"{_MARKS[severity]} {escape(shown)}")

    def confirm(self, sentence: str) -> bool:
        """Ask a person; without one at the terminal, and when interrupted, the answer is no."""
        self._end_footer()
        if not sys.stdin.isatty():
            self.say("nobody is here to answer; use --yes in simulation", "error")
            return False
        termios.tcflush(sys.stdin, termios.TCIFLUSH)  # what was typed before the question is no answer to it
        click.echo(f"? {sentence} [y/N]: ", nl=False, err=True)
        while not self._stop.is_set():
            if select.select([sys.stdin], [], [], _LISTEN_S)[0]:
                return sys.stdin.readline().strip().lower() in ("y", "yes")
        click.echo(err=True)
        return False

    def show(self, health: list[Health]) -> None:
        """Refresh the table of the servers."""
        now_s = time.monotonic()
        if now_s - self._shown_s >= _SHOW_S:
            self._shown_s = now_s
            self._footer(render_servers(health))

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)

    def _footer(self, what: RenderableType) -> None:
        if not self._console.is_terminal:
            return
        if self._live is None:
            self._live = Live(console=self._console, transient=True, auto_refresh=False)
            self._live.start()
        self._live.update(what, refresh=True)

    def _end_footer(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None


class _Log(logging.Handler):
    """Shows what is logged, among the steps; but for the bus, of whose loss the session tells."""

    def __init__(self, face: TerminalFace) -> None:
        super().__init__()
        self._face = face

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        if record.name.startswith("station.bus"):
            return
        severity: Severity = (
            "error" if record.levelno >= logging.ERROR else "warning" if record.levelno >= logging.WARNING else "info"
        )
        self._face.say(record.getMessage(), severity)
