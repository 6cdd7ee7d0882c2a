"""How a session shows itself: a line per step, below them in a terminal how the run is going, live."""

from __future__ import annotations

import logging
import select
import sys
import termios
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType

import click
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape

from station.bus.client import Bus
from station.errors import BusError
from station.life.events import Severity
from station.life.server import Health
from station.view import progress_panel
from station.view.progress import ProgressReader
from station.view.table import plain, render_servers

_REFRESH_HZ = 8
_LOOK_S = 0.5  # without a screen
_TELL_S = 10.0  # without a screen, while the same is being played
_LISTEN_S = 0.05
_LONGEST = 200  # characters of something that happened; the log and the episode have the rest
_MARKS: dict[Severity, str] = {"info": "[cyan]·[/]", "warning": "[yellow]![/]", "error": "[red]✗[/]"}


class TerminalFace:
    """Prints steps and events to stderr; a real terminal has a footer below them that tells how the run is going.

    Args:
        stop: Ends a question without an answer when it is set.
        is_brief: For somebody who looks on: no table of the servers, and lines of progress where there is no screen.
    """

    def __init__(self, stop: threading.Event, *, is_brief: bool = False) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._stop, self._is_brief = stop, is_brief
        self._live: Live | None = None
        self._step = ""
        self._names: Sequence[str] = ()
        self._progress: ProgressReader | None = None
        self._told, self._told_s, self._looked_s = "", 0.0, 0.0
        self._log = _Log(self)
        self._handlers: list[logging.Handler] = []

    @contextmanager
    def watching(self, bus: Bus, names: Sequence[str]) -> Iterator[None]:
        """Show, until the end of the block, how the run of some servers on a bus is going."""
        self._names, self._progress = names, ProgressReader(bus, names)
        try:
            yield
        finally:
            self._end_footer()
            self._progress = None

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
        self._step = step
        self._begin_footer()

    def done(self, step: str, result: str) -> None:
        """Print a finished step and its result."""
        self._step = ""
        self._print(f"[green]✓[/] {plain(step)}  [dim]{plain(result)}[/]")

    def failed(self, step: str, reason: str) -> None:
        """Print a step that failed."""
        self._step = ""
        self._print(f"[red]✗[/] {plain(step)}  [red]{plain(reason)}[/]")

    def say(self, text: str, severity: Severity = "info") -> None:
        """Print a line."""
        shown = text if len(text) <= _LONGEST or severity != "info" else text[:_LONGEST] + "…"
        self._print(f"{_MARKS[severity]} {plain(shown)}")

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
        """Show how the run goes; the footer looks for itself, more often than it is told."""
        self._begin_footer()
        if self._is_brief and not self._console.is_terminal:
            self._tell_progress()

    def _tell_progress(self) -> None:
        """Print a line when something else is being played, and now and then."""
        now_s = time.monotonic()
        if self._progress is None or now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        seen = self._progress.look()
        what = progress_panel.doing(seen.motion) if seen.motion is not None else ""
        if what and (what != self._told or now_s - self._told_s >= _TELL_S):
            self._told, self._told_s = what, now_s
            self.say(progress_panel.line(seen))

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)

    def _begin_footer(self) -> None:
        if self._live is None and self._console.is_terminal:
            self._live = Live(console=self._console, transient=True, get_renderable=self._footer,
                              refresh_per_second=_REFRESH_HZ)  # fmt: skip
            self._live.start()

    def _footer(self) -> RenderableType:
        """Return what stands below the lines; called by a thread of the terminal's."""
        if self._progress is None:
            return f"[dim]… {escape(self._step)}[/]" if self._step else ""
        try:
            seen = self._progress.look()
        except BusError:  # the session tells of it
            return f"[dim]… {escape(self._step)}[/]" if self._step else ""
        panel = progress_panel.panel(seen, self._names, self._step)
        return panel if self._is_brief else Group(panel, "", render_servers(seen.servers))

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
