"""A verb on a real terminal, with somebody who reads the screen and types."""

from __future__ import annotations

import codecs
import os
import pty
import signal
import subprocess
import sys
import termios
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.cli.running import Home
from tests.main_job.station_runs import ROOT
from tests.waiting import wait_until

_AT_TERMINAL = (
    "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execv(sys.argv[1], sys.argv[1:])"
)
"""Run by the child itself: between fork and exec of a process with threads no code is safe, see `station.bus.tied`."""
_END = "\0the end\0"
"""Written behind all that a process has written."""


class AtTerminal:
    """A process whose terminal we hold; a context manager that kills it.

    Args:
        home: Where it runs.
        arguments: The verb and what belongs to it.
        program: What Python runs in place of the station, as words of its command line.
        columns: Width of the terminal.
    """

    def __init__(
        self, home: Home, *arguments: str, program: Sequence[str] = ("-m", "station"), columns: int = 400
    ) -> None:
        self._ours, theirs = pty.openpty()
        self.before = self.settings()
        self.process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _AT_TERMINAL, sys.executable, *program, *arguments],
            env={**home.environment, "TERM": "xterm", "COLUMNS": f"{columns}", "LINES": "40",
                 "PYTHONFAULTHANDLER": "1"},
            cwd=ROOT, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
        )  # fmt: skip
        self._theirs = theirs  # kept open, so that its settings can be read when the process has ended
        self.screen = ""
        self._screen_lock = threading.Lock()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def settings(self) -> list[Any]:
        """How the terminal is set."""
        return termios.tcgetattr(self._ours)

    def wait_for(self, text: str, after: int = 0) -> int:
        """Wait until the screen has shown a text, behind a place; return the place behind it."""
        self.wait_for_any(text, after=after)
        return self.screen.index(text, after) + len(text)

    def wait_for_any(self, *texts: str, after: int = 0) -> None:
        """Wait until the screen has shown one of some texts, behind a place."""

        def is_shown() -> bool:
            return any(text in self.screen[after:] for text in texts)

        try:
            wait_until(lambda: is_shown() or self.process.poll() is not None)
        finally:
            assert is_shown(), f"none of {texts} (exit code {self.process.poll()}) in:\n{self.screen[after:]}"

    def type(self, keys: bytes) -> None:
        os.write(self._ours, keys)

    def send(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def finish(self) -> int:
        """Wait for the end; return the exit code. What does not end fails with its screen and where its threads are."""
        try:
            code = self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.send(signal.SIGABRT)
            self.process.wait(10)
            self._read_all()
            raise AssertionError(f"it did not end; its screen:\n{self.screen}") from None
        self._read_all()
        return code

    def __enter__(self) -> AtTerminal:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._theirs)
        self._reader.join(10.0)
        os.close(self._ours)

    def _read(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")(errors="replace")
        while data := _some(self._ours):
            with self._screen_lock:
                self.screen += decoder.decode(data)

    def _read_all(self) -> None:
        """Wait until all that was written stands on the screen."""
        os.write(self._theirs, _END.encode())
        wait_until(lambda: _END in self.screen)
        with self._screen_lock:
            self.screen = self.screen.replace(_END, "")


def stands_still(pid: int) -> bool:
    """Whether a process was told to stand still."""
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "T"


def at_a_terminal(home: Home, *arguments: str, until: str, then: bytes) -> tuple[int, str]:
    """Run a verb on a real terminal, type something once it has shown a text; return exit code and all it showed."""
    with AtTerminal(home, *arguments) as terminal:
        terminal.wait_for(until)
        terminal.type(then)
        return terminal.finish(), terminal.screen


def _some(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 4096)
    except OSError:  # Linux says so where others say end of file
        return b""
