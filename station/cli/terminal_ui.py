"""How a session shows itself: a line per step, below them in a terminal how the run is going, live."""

from __future__ import annotations

import getpass
import logging
import sys
import threading
import time
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape

from station.arms import remedy_of
from station.bus.client import Bus
from station.cli.keyboard import Keyboard
from station.errors import BusError, StoppedPastBus
from station.life.events import Severity
from station.life.server import Health
from station.life.stop_button import StopButton
from station.printable import printable
from station.view import progress_panel
from station.view.progress import ProgressReader
from station.view.table import plain, render_servers

_REFRESH_HZ = 8
_LOOK_S = 0.5  # without a screen
_LISTEN_S = 0.05
_TELL_S = 10.0  # without a screen, while the same is being played
_AGAIN = ("r", "R")
_LONGEST = 200  # characters of something that happened; the log and the episode have the rest
_ANSWERS = {"y": True, "yes": True, "n": False, "no": False, "": False}
_MARKS: dict[Severity, str] = {"info": "[cyan]·[/]", "warning": "[yellow]![/]", "error": "[red]✗[/]"}

KEYS = (" ", "e", "E")
_KEY = "key in `station up`"
HINT = "SPACE or e: emergency stop"

_REPEATS_S = 1.0  # a key that is held down repeats thirty times a second


class TerminalUI:
    """Prints steps and events to stderr; a real terminal has a footer below them that tells how the run is going, and
    keys: for the emergency stop, at any time, for what a session offers, and for a device that reads keys.

    Args:
        stop: Ends a question without an answer when it is set.
        is_brief: For somebody who looks on: no table of the servers, and lines of progress where there is no screen.
        waits_for_console: Whether somebody answers on the bus where nobody can type here.

    Attributes:
        estop_directly: What the emergency stop's key does beside writing it to the bus.
        look_for_dead: Tells how servers ended that have died and are not started again, by name; called by a thread.
    """

    def __init__(self, stop: threading.Event, *, is_brief: bool = False, waits_for_console: bool = False) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._stop, self._is_brief, self._waits_for_console = stop, is_brief, waits_for_console
        self._live: Live | None = None
        self._step = ""
        self._names: Sequence[str] = ()
        self._progress: ProgressReader | None = None
        self._told, self._told_s, self._looked_s = "", 0.0, 0.0
        self._log = _Log(self)
        self._handlers: list[logging.Handler] = []
        self._stop_key: StopKey | None = None
        self.estop_directly: Callable[[str], object] = lambda _: None
        self.look_for_dead: Callable[[], Mapping[str, str]] = dict
        self._keyboard = Keyboard(self._act_at_once, self._take, self._watch_stop, self._echo)
        self._offered, self._is_taken = "", False

    @contextmanager
    def watching(self, bus: Bus, names: Sequence[str]) -> Iterator[None]:
        """Show, until the end of the block, how the run of some servers on a bus is going, and listen to the keys."""
        self._names, self._progress = names, ProgressReader(bus, names)
        try:
            with StopButton(bus.address, name="stop-key") as button, self._keyboard:
                self._stop_key = StopKey(button, self._stop_directly, self.report)
                if self._keyboard.is_there and not self._console.is_terminal:
                    self.report(HINT)
                yield
        finally:
            self._stop_key = None
            self._end_footer()
            self._progress = None

    @property
    def lent_terminal(self) -> str:
        """Name of the pseudo terminal for servers; "" where nobody can type here."""
        return self._keyboard.lent_name

    @property
    def is_attended(self) -> bool:
        """Whether a person is at the terminal, or is to answer on the bus."""
        return self._keyboard.is_there or self._waits_for_console

    def offer(self, restart: str) -> None:
        """Show that a key starts some servers again, or no more."""
        self._offered, self._is_taken = restart, False

    def pop_restart(self) -> bool:
        """Whether that key was pressed since the last call."""
        if not self._is_taken:
            return False
        self._is_taken = False  # nowhere else: a key of this moment is not lost
        return True

    def __enter__(self) -> TerminalUI:
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

    def report(self, text: str, severity: Severity = "info") -> None:
        """Print a line."""
        shown = text if len(text) <= _LONGEST or severity != "info" else text[:_LONGEST] + "…"
        self._print(f"{_MARKS[severity]} {plain(shown)}")

    def confirm(self, sentence: str, is_answered: Callable[[], bool]) -> bool:
        """Ask a person; without one at the terminal, and when interrupted, the answer is no."""
        hint = "y goes on; n, or Enter alone, takes the station down"
        return _ANSWERS.get(self._answer(f"{sentence} [y/N]", _ANSWERS, hint, is_answered) or "", False)

    def ask(self, question: str, answers: Sequence[str], is_answered: Callable[[], bool]) -> str:
        """Ask a person for one of some words; without one at the terminal, and when interrupted, it is ""."""
        listed = {answer.lower(): answer for answer in answers}
        hint = f"expected one of {', '.join(answers)}"
        return listed.get(self._answer(f"{question} [{'/'.join(answers)}]", listed, hint, is_answered) or "", "")

    def _answer(self, question: str, answers: Container[str], hint: str, is_answered: Callable[[], bool]) -> str | None:
        """Ask until the answer is one of some; None where nobody gives one here."""
        self._end_footer()
        if not self._keyboard.is_there:
            if self._waits_for_console:
                self.report(f"waiting for an answer from a console: {question}", "warning")
                while not is_answered() and not self._stop.wait(_LISTEN_S):
                    pass
            else:
                self.report("nobody is here to answer; use --yes in simulation, or --ask console", "error")
            return None
        while True:
            answer = self._keyboard.ask(f"? {question} ({HINT}): ", self._stop, is_answered).strip().lower()
            if self._stop.is_set() or is_answered():
                self._echo("\n")
                return None
            if answer in answers:
                return answer
            self.report(f"{answer!r} is no answer: {hint}", "warning")

    def show(self, health: list[Health]) -> None:
        """Begin the footer, which reads by itself how the servers are; without a screen print progress if brief."""
        self._begin_footer()
        if self._is_brief and not self._console.is_terminal:
            self._print_progress()

    def _print_progress(self) -> None:
        """Print a line when something else is being played, and now and then."""
        now_s = time.monotonic()
        if self._progress is None or now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        seen = self._progress.poll()
        what = progress_panel.doing(seen.motion) if seen.motion is not None else ""
        if what and (what != self._told or now_s - self._told_s >= _TELL_S):
            self._told, self._told_s = what, now_s
            self.report(progress_panel.line(seen))

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)

    def _begin_footer(self) -> None:
        if self._live is None and self._console.is_terminal:
            self._live = Live(console=self._console, transient=True, get_renderable=self._footer,
                              refresh_per_second=_REFRESH_HZ)  # fmt: skip
            self._live.start()

    def _footer(self) -> RenderableType:
        """Return what stands below the lines; called by a thread of the terminal's."""
        return Group(*self._progress_lines(), self._key_line())

    def _progress_lines(self) -> Iterator[RenderableType]:
        try:
            seen = self._progress.poll() if self._progress is not None else None
        except BusError:  # the session tells of it
            seen = None
        if seen is None:
            yield f"[dim]… {escape(self._step)}[/]" if self._step else ""
            return
        yield progress_panel.panel(seen, self._names, self._step, self.look_for_dead())
        if not self._is_brief:
            yield from ("", render_servers(seen.servers, self._console.width))
        gates = {one.gate for one in (seen.robot, seen.arm) if one is not None}
        if "stopped" in gates:
            yield "[bold red]EMERGENCY STOP is latched; release it with: station estop --reset[/]"
        if seen.arm is not None and seen.arm.gate == "faulted":
            yield f"[bold red]the arm's controller has a fault; {escape(printable(remedy_of(seen.arm.reason)))}[/]"

    def _key_line(self) -> RenderableType:
        if not self._keyboard.is_there:
            return ""
        again = f"[bold yellow]r: start {escape(self._offered)} again[/] · " if self._offered else ""
        return f"{again}[bold]{HINT}[/] · Ctrl-C: take down"

    def _act_at_once(self, key: str, is_typing: bool) -> bool:
        """Stop the robots if that is what a key asks for; in an answer such as "yes" an e is a letter."""
        if self._stop_key is None or key not in KEYS or (is_typing and key != " "):
            return False
        self._stop_key.press()
        return True

    def _take(self, key: str) -> bool:
        """Start servers again if that is offered and the key asks for it; return whether the key was used."""
        if takes := bool(self._offered) and key in _AGAIN:
            self._is_taken = True
        return takes

    def _stop_directly(self) -> None:
        self.estop_directly(f"{getpass.getuser()}, {_KEY}")

    def _watch_stop(self) -> None:
        if self._stop_key is not None:
            self._stop_key.try_again()

    def _echo(self, text: str) -> None:
        sys.stderr.write(text)
        sys.stderr.flush()

    def _end_footer(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None


class _Log(logging.Handler):
    """Shows what is logged, among the steps; but for the bus, of whose loss the session tells."""

    def __init__(self, face: TerminalUI) -> None:
        super().__init__()
        self._ui = face

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        if record.name.startswith("station.bus"):
            return
        severity: Severity = (
            "error" if record.levelno >= logging.ERROR else "warning" if record.levelno >= logging.WARNING else "info"
        )
        self._ui.report(record.getMessage(), severity)


class StopKey:
    """Called by the keyboard's thread.

    Args:
        button: What it presses.
        directly: Tells the servers of this station without the bus.
        say: Prints a line.
    """

    def __init__(self, button: StopButton, directly: Callable[[], None], say: Callable[[str, Severity], None]) -> None:
        self._button, self._directly, self._say = button, directly, say
        self._pressed_s: float | None = None  # of a press that the bus has not taken yet
        self._told_s = 0.0

    def press(self) -> None:
        """Stop every robot; pressed again it does so again."""
        self._directly()
        try:
            self._button.press(_KEY)
        except BusError as error:
            own = "" if isinstance(error, StoppedPastBus) else "; this station's own servers were told directly"
            self._say(f"EMERGENCY STOP: {error}{own}; trying on", "error")
            self._pressed_s = self._pressed_s or time.monotonic()
            return
        self._pressed_s = None
        if time.monotonic() - self._told_s > _REPEATS_S:
            self._say("EMERGENCY STOP: the robots are damped until `station estop --reset`", "error")
        self._told_s = time.monotonic()

    def try_again(self) -> None:
        """Press once more where the bus has not taken it; called again and again."""
        if self._pressed_s is None:
            return
        try:
            self._button.press(f"{_KEY}, late")
        except BusError:
            return
        late_s, self._pressed_s = time.monotonic() - self._pressed_s, None
        self._say(f"EMERGENCY STOP: taken {late_s:.1f} s after the key; the robots are damped", "error")
