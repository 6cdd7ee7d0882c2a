"""The keys of a terminal, one at a time, from a thread that waits for nothing else.

The terminal gives each key at once and does not show it; at every exit (an exception and a signal that asks for an
orderly end included) it is put back as it was. Ctrl-C stays a signal. Ctrl-Z and Ctrl-S do nothing: a supervisor that
sleeps, or waits for its screen, watches over nobody.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Any

_ERASE = ("\x7f", "\b")
_ENTER = ("\n", "\r")
_ESCAPE = b"\x1b"  # an arrow or function key: a sequence whose letters are no keys of ours
_IDLE_S = 0.25
_LISTEN_S = 0.05
_MOST = 64  # keys that nobody has taken; a cat may sit on them

_LFLAG, _IFLAG, _CC = 3, 0, 6  # places in what termios returns


class Keyboard:
    """A context manager; without a person at the terminal it does nothing.

    Args:
        act_at_once: Called in the keyboard's thread with each key, and whether an answer is being typed; True where
            that was all, and nobody else is to see the key.
        idle: Called in the same thread a few times a second.
        show: Prints what is typed as the answer to a question.
    """

    def __init__(
        self, act_at_once: Callable[[str, bool], bool], idle: Callable[[], None], show: Callable[[str], None]
    ) -> None:
        self._act_at_once, self._idle, self._show = act_at_once, idle, show
        self._keys: deque[str] = deque(maxlen=_MOST)
        self._typed: str | None = None  # the answer so far, while a question is open
        self._answered = threading.Event()
        self._before: list[Any] | None = None
        self._thread: threading.Thread | None = None
        self._wake = -1

    @property
    def is_there(self) -> bool:
        """Whether a person can type."""
        return self._before is not None

    def pop(self) -> str:
        """Return the oldest key that nobody has taken, "" for none."""
        return self._keys.popleft() if self._keys else ""

    def ask(self, question: str, stop: threading.Event) -> str:
        """Show a question; return the line that is typed from now on, or "" when `stop` is set before it ends."""
        self._answered.clear()
        self._typed = ""  # first: who answers as soon as the question is there is heard
        self._show(question)
        while not self._answered.wait(_LISTEN_S) and not stop.is_set() and self.is_there:
            pass
        answer, self._typed = self._typed, None
        return answer if self._answered.is_set() else ""

    def __enter__(self) -> Keyboard:
        if not _is_ours(sys.stdin):
            return self
        self._before = termios.tcgetattr(sys.stdin)
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
                if not data.startswith(_ESCAPE):
                    for key in data.decode(errors="replace"):
                        self.press(key)
        except OSError:
            return  # likewise
        finally:
            os.close(wake)

    def press(self, key: str) -> None:
        """Add a key that was typed; called in the keyboard's thread."""
        typed = self._typed
        if self._act_at_once(key, bool(typed)):
            return
        if typed is None or self._answered.is_set():
            self._keys.append(key)
        elif key in _ENTER:
            self._show("\n")
            self._answered.set()
        elif key in _ERASE:
            self._typed = typed[:-1]
            self._show("\b \b" * bool(typed))
        elif key.isprintable():
            self._typed = typed + key
            self._show(key)


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
