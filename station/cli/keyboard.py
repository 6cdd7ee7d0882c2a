"""The keys of a terminal, one at a time, from a thread that waits for nothing else.

The terminal gives each key at once and does not show it; at every exit (an exception and a signal that asks for an
orderly end included) it is put back as it was. Ctrl-C stays a signal. Ctrl-Z and Ctrl-S do nothing: a supervisor that
sleeps, or waits for its screen, watches over nobody.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable
from types import TracebackType
from typing import Any

_ERASE = ("\x7f", "\b")
_ENTER = ("\n", "\r")
_KEY = re.compile(r"\x1b(?:\[[0-9;]*[A-Za-z~]|O[A-Za-z])|.", re.DOTALL)
"""A key as a terminal sends it: an arrow or function key is a sequence, whose letters are no keys."""
_IDLE_S = 0.25
_LISTEN_S = 0.05
_DEAF_S = 1.0  # an Enter that was on its way to a question must not begin to drive a robot

_LFLAG, _IFLAG, _CC = 3, 0, 6  # places in what termios returns


class Keyboard:
    """A context manager; without a person at the terminal it does nothing.

    Args:
        act_at_once: Called in the keyboard's thread with each key, and whether an answer is being typed; True where
            that was all, and nobody else is to see the key.
        take: Called in the same thread with each other key that is typed while no question is open; True if it
            was used. A key that was not used is sent to the servers (`LentTerminal`).
        idle: Called in the same thread a few times a second.
        show: Prints what is typed as the answer to a question.
    """

    def __init__(
        self,
        act_at_once: Callable[[str, bool], bool],
        take: Callable[[str], bool],
        idle: Callable[[], None],
        show: Callable[[str], None],
    ) -> None:
        self._act_at_once, self._take, self._idle, self._show = act_at_once, take, idle, show
        self._typed: str | None = None  # the answer so far, while a question is open
        self._answered = threading.Event()
        self._deaf_until_s = 0.0
        self._before: list[Any] | None = None
        self._thread: threading.Thread | None = None
        self._wake = -1
        self._lent: LentTerminal | None = None

    @property
    def is_there(self) -> bool:
        """Whether a person can type."""
        return self._before is not None

    @property
    def lent_name(self) -> str:
        """Name of the pseudo terminal for servers; "" where nobody can type here."""
        return self._lent.name if self._lent is not None else ""

    def ask(self, question: str, stop: threading.Event, is_answered: Callable[[], bool] = lambda: False) -> str:
        """Show a question; return the line that is typed from now on, or "" when `stop` is set before it ends.

        Once it `is_answered` by somebody else it ends as well; what was about to be typed is nobody's key for a moment.
        """
        self._answered.clear()
        self._typed = ""  # first: who answers as soon as the question is there is heard
        self._show(question)
        while not self._answered.wait(_LISTEN_S) and not stop.is_set() and not is_answered() and self.is_there:
            pass
        if not self._answered.is_set() and is_answered():
            self._deaf_until_s = time.monotonic() + _DEAF_S
        answer, self._typed = self._typed, None
        return answer if self._answered.is_set() else ""

    def __enter__(self) -> Keyboard:
        if not _is_ours(sys.stdin):
            return self
        self._before, self._lent = termios.tcgetattr(sys.stdin), LentTerminal()
        reading, self._wake = os.pipe()
        _set(_one_at_a_time(self._before))
        termios.tcflush(sys.stdin, termios.TCIFLUSH)  # what was typed before is no answer to anything
        self._thread = threading.Thread(target=self._listen, args=(reading,), name="keyboard", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        before, self._before = self._before, None
        if before is not None and self._thread is not None:
            _set(before)
            os.close(self._wake)
            self._thread.join()
        if self._lent is not None:
            self._lent.close()

    def _listen(self, wake: int) -> None:
        try:
            while True:
                ready = select.select([sys.stdin, wake], [], [], _IDLE_S)[0]
                if wake in ready:
                    return
                if not ready:
                    self._idle()
                    continue
                data = os.read(sys.stdin.fileno(), 256)
                if not data:
                    return  # the terminal is gone; so is who typed
                for key in keys_of(data):
                    self.press(key)
        except OSError:
            return  # likewise
        finally:
            os.close(wake)

    def press(self, key: str) -> None:
        """Use a key that was typed, or send it to the servers; called in the keyboard's thread."""
        typed = self._typed
        if self._act_at_once(key, bool(typed)):
            return
        if typed is None and time.monotonic() < self._deaf_until_s:
            return
        if typed is None or self._answered.is_set():
            if not self._take(key) and self._lent is not None:
                self._lent.type(key.encode())
        elif key in _ENTER:
            self._show("\n")
            self._answered.set()
        elif key in _ERASE:
            self._typed = typed[:-1]
            self._show("\b \b" * bool(typed))
        elif key.isprintable():
            self._typed = typed + key
            self._show(key)


class LentTerminal:
    """A pseudo terminal for the servers of a station, which are started without a terminal.

    Keys that are typed here and that `station up` does not use are sent to it. Servers find its name in their
    environment (`station.operator.device.LENT_TERMINAL`), and open it like any other terminal.

    Attributes:
        name: Its name, such as ``/dev/pts/3``.
    """

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        tty.setcbreak(self._slave)  # what is typed before anybody has opened it is not echoed
        self.name = os.ttyname(self._slave)

    def type(self, keys: bytes) -> None:
        """Send keys to the server that reads them. They are dropped while its buffer is full: nothing reads."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, keys)

    def close(self) -> None:
        """Close both ends; a server that still reads sees a closed terminal."""
        os.close(self._slave)
        os.close(self._master)


def keys_of(data: bytes) -> list[str]:
    """Return the keys in what a terminal sent at once, in order."""
    found: list[str] = _KEY.findall(data.decode(errors="replace"))
    return found


def _is_ours(stream: Any) -> bool:
    """Whether a stream is a terminal that we may set: in the background, setting it would stop us."""
    return bool(stream is not None and stream.isatty() and os.tcgetpgrp(stream.fileno()) == os.getpgrp())


def _one_at_a_time(before: list[Any]) -> list[Any]:
    wanted = [*before[:_CC], list(before[_CC])]
    wanted[_LFLAG] &= ~(termios.ICANON | termios.ECHO)
    wanted[_IFLAG] &= ~termios.IXON
    wanted[_CC][termios.VMIN], wanted[_CC][termios.VTIME] = 1, 0
    wanted[_CC][termios.VSUSP] = os.fpathconf(sys.stdin.fileno(), "PC_VDISABLE").to_bytes(1, "little")
    return wanted


def _set(wanted: list[Any]) -> None:
    try:
        termios.tcsetattr(sys.stdin, termios.TCSANOW, wanted)
    except termios.error:
        return  # the terminal was closed: there is nothing to put back
