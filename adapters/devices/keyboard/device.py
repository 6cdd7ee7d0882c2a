"""The keyboard as an operator's device, read from a terminal.

A terminal tells when a key goes down and never when it comes up. So a key counts as held for a moment after each press,
which is enough for a discrete command and for a short jog; **it can be no dead-man**: a person who falls over with a
finger on the key looks just as one who lets go, and auto-repeat pauses for half a second after the first press.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import math
import os
import select
import termios
import time
from collections.abc import Callable
from typing import Any

from adapters.devices.keyboard import keys
from station.operator.device import LENT_TERMINAL, DeviceError
from station.operator.sample import OperatorSample

HOLD_S = 0.15
OWN_TERMINAL = "/dev/tty"

_ESCAPE_S = 0.03  # an arrow's three bytes come together; an ESC that is alone for so long is the key
_CHUNK = 1024
_LFLAG, _IFLAG, _CC = 3, 0, 6  # places in what termios returns

_HOW = (
    "run `station up` or `station serve keyboard` in a terminal, or name with tty one in which nothing else reads "
    "(there: `tty; sleep infinity`)"
)


class Keyboard:
    """Reads the keys of a terminal.

    The terminal gives each key at once and does not show it; it is put back as it was by `close`, and at the latest
    when the process ends in an orderly way. Ctrl-C stays a signal. A terminal that is closed gives one more sample,
    without keys, before it is gone.

    Args:
        tty: Name of the terminal, such as ``/dev/pts/3``; "" for the keys of the terminal of ``station up``, or
            else for the terminal of the process.
        hold_s: For how long a key counts as held after each press [s].
        clock: Tells the time [s]; replaced in tests.

    Raises:
        DeviceError: there is no such terminal, or it is not ours to read.
    """

    def __init__(self, *, tty: str = "", hold_s: float = HOLD_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._tty = tty or os.environ.get(LENT_TERMINAL, "") or OWN_TERMINAL
        self._hold_s, self._clock = hold_s, clock
        self._terminal = _open(self._tty)
        self._before: list[Any] = []
        try:
            self._before = termios.tcgetattr(self._terminal)
            termios.tcsetattr(self._terminal, termios.TCSAFLUSH, _one_at_a_time(self._before))  # typed before: nobody's
        except termios.error as error:
            self.close()
            raise DeviceError(f"{self._tty}: cannot be set: {error.args[-1]}; {_HOW}") from None
        atexit.register(self.close)
        self._held_until_s = dict.fromkeys(sorted(keys.NAMES), -math.inf)
        self._waiting, self._waiting_since_s = b"", 0.0
        self._lost = ""

    def read(self) -> OperatorSample | None:
        """Return which keys are held, and which are not; never blocks.

        Raises:
            DeviceError: the terminal was closed, and a sample without keys has been given.
        """
        if self._lost:
            self.close()
            raise DeviceError(self._lost)
        now_s = self._clock()
        try:
            pressed = self._read_keys(now_s)
        except OSError:
            self._lost = f"{self._tty}: the terminal was closed; {_HOW}"
            self._held_until_s, pressed = dict.fromkeys(self._held_until_s, -math.inf), []
        for key in pressed:
            self._held_until_s[key] = now_s + self._hold_s
        return OperatorSample(
            controls={f"key_{key}": float(now_s < until_s) for key, until_s in self._held_until_s.items()}
        )

    def why_silent(self) -> str:
        """Return why the terminal is gone, or "": without a key press a terminal is at rest, not silent."""
        return self._lost

    def facts(self) -> dict[str, Any]:
        """Return the terminal; it does not tell when a key comes up, so no dead-man may depend on it."""
        return {"device": "keyboard", "tty": self._tty, "hold_s": self._hold_s, "tells_release": False}

    def close(self) -> None:
        """Put the terminal back as it was and let go of it."""
        terminal, self._terminal = self._terminal, -1
        if terminal < 0:
            return
        atexit.unregister(self.close)
        if self._before:
            with contextlib.suppress(termios.error):  # it was closed: there is nothing to put back
                termios.tcsetattr(terminal, termios.TCSANOW, self._before)
        os.close(terminal)

    def _read_keys(self, now_s: float) -> list[str]:
        """Read all that was typed; raises OSError for a terminal that is gone."""
        data = b""
        while select.select([self._terminal], [], [], 0.0)[0]:
            chunk = os.read(self._terminal, _CHUNK)
            if not chunk:
                raise OSError("end of file")
            data += chunk
        if data:
            self._waiting_since_s = now_s
        is_all = not data and now_s - self._waiting_since_s >= _ESCAPE_S
        pressed, self._waiting = keys.parse(self._waiting + data, is_all=is_all)
        return pressed


def _open(tty: str) -> int:
    try:
        terminal = os.open(tty, os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
    except OSError as error:
        if tty == OWN_TERMINAL:
            raise DeviceError(f"this process has no terminal; {_HOW}") from None
        raise DeviceError(f"{tty}: cannot be opened: {error.strerror}; {_HOW}") from None
    why = ""
    if not os.isatty(terminal):
        why = "is no terminal"
    elif tty == OWN_TERMINAL and os.tcgetpgrp(terminal) != os.getpgrp():
        why = "is read by another program, this one is in the background"  # setting it would stop us
    else:
        try:
            fcntl.flock(terminal, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until it is closed
        except BlockingIOError:
            why = "is read by another keyboard server: each would get some of the keys"
    if why:
        os.close(terminal)
        raise DeviceError(f"{tty}: {why}; {_HOW}")
    return terminal


def _one_at_a_time(before: list[Any]) -> list[Any]:
    wanted = [*before[:_CC], list(before[_CC])]
    wanted[_LFLAG] &= ~(termios.ICANON | termios.ECHO)
    wanted[_IFLAG] &= ~termios.IXON
    wanted[_CC][termios.VMIN], wanted[_CC][termios.VTIME] = 1, 0
    return wanted
