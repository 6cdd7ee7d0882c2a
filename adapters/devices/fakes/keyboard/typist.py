"""A typist at a terminal: a pseudo terminal into which a script types.

{"device": "keyboard", "steps": [
    {"at_s": 0.5, "press": "w"},                    one press
    {"at_s": 1.0, "press": "up", "for_s": 2.0},     held: pressed, and after half a second repeated 30 times a second
    {"at_s": 4.0, "text": "Hello"},
    {"at_s": 5.0, "plugged": false}, {"at_s": 6.0, "plugged": true}]}       the terminal is closed, and another opened
"""

from __future__ import annotations

import contextlib
import heapq
import os
import tempfile
import threading
import time
import tty
from pathlib import Path

from adapters.devices.fakes.script import Clock, Play, Script, Step
from adapters.devices.keyboard import keys
from station.errors import did_you_mean

REPEAT_AFTER_S = 0.5
REPEAT_S = 1.0 / 30.0

_LOOK_S = 0.004
_ROUNDING_S = 1e-9


class TypistStep(Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a typist may do.

    Attributes:
        press: The name of a key.
        for_s: How long it is held [s].
        text: What is typed.
        plugged: Whether there is a terminal from now on.
    """

    press: str | None = None
    for_s: float = 0.0
    text: str | None = None
    plugged: bool | None = None

    def __post_init__(self) -> None:
        if self.press is not None and (self.press not in keys.NAMES or self.press in ("shift", "alt")):
            raise ValueError(f"no key {self.press!r}{did_you_mean(self.press, keys.NAMES)}")
        if not 0.0 <= self.for_s <= 600.0:
            raise ValueError(f"for_s is {self.for_s:g}; expected 0 to 600 s")


class Typing:
    """The bytes that a script types by a time.

    Args:
        script: What is typed.
        clock: Tells the time [s].
    """

    def __init__(self, script: Script[TypistStep], clock: Clock) -> None:
        self._play = Play(script, clock)
        self._coming: list[tuple[float, int, bytes | bool]] = []
        self._count = 0
        self._start_s = 0.0

    def begin(self, start_s: float = 0.0) -> None:
        """Start the clock, at a time of the script [s]: what was typed before is not typed again."""
        self._start_s = start_s
        self._play.begin(start_s)

    def due(self) -> list[bytes | bool]:
        """Return, once, what is typed by now in order, and True or False where the terminal comes or goes."""
        if not self._play.has_begun:
            return []
        now_s = self._play.time_s()
        for at_s, step in self._play.due(now_s):
            self._plan(at_s, step)
        found: list[bytes | bool] = []
        while self._coming and self._coming[0][0] <= now_s + _ROUNDING_S:
            at_s, _, what = heapq.heappop(self._coming)
            if at_s >= self._start_s or isinstance(what, bool):
                found.append(what)
        return found

    def _plan(self, at_s: float, step: TypistStep) -> None:
        if step.plugged is not None:
            self._add(at_s, step.plugged)
        if step.text is not None:
            self._add(at_s, step.text.encode())
        if step.press is not None:
            self._add(at_s, keys.send(step.press))
            repeats = (
                int((step.for_s - REPEAT_AFTER_S) / REPEAT_S + _ROUNDING_S) + 1 if step.for_s >= REPEAT_AFTER_S else 0
            )
            for index in range(repeats):
                self._add(at_s + REPEAT_AFTER_S + index * REPEAT_S, keys.send(step.press))

    def _add(self, at_s: float, what: bytes | bool) -> None:
        self._count += 1
        heapq.heappush(self._coming, (at_s, self._count, what))


class FakeTerminal:
    """A terminal under a name of its own, with a typist.

    Args:
        script: What is typed from `begin` on.
        clock: Tells the time [s].

    Attributes:
        path: The name of the terminal.
    """

    def __init__(self, script: Script[TypistStep], clock: Clock = time.monotonic) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="fake-keyboard-")
        self.path = Path(self._folder.name) / "tty"
        self._typing = Typing(script, clock)
        self._master, self._slave = -1, -1
        self._stop = threading.Event()
        self._plug()
        self._thread = threading.Thread(target=self._run, name="fake-keyboard", daemon=True)
        self._thread.start()

    def begin(self, start_s: float = 0.0) -> None:
        """Start the script's clock, at a time of the script [s]."""
        self._typing.begin(start_s)

    def close(self) -> None:
        """Take the terminal away."""
        self._stop.set()
        self._thread.join()
        self._unplug()
        self._folder.cleanup()

    def _run(self) -> None:
        while not self._stop.wait(_LOOK_S):
            for what in self._typing.due():
                if isinstance(what, bool):
                    (self._plug if what else self._unplug)()
                elif self._master >= 0:
                    os.write(self._master, what)

    def _plug(self) -> None:
        if self._master < 0:
            self._master, self._slave = os.openpty()
            tty.setcbreak(self._slave)  # what is typed before anybody has opened it is not echoed back
            self.path.unlink(missing_ok=True)
            self.path.symlink_to(os.ttyname(self._slave))

    def _unplug(self) -> None:
        if self._master >= 0:
            self.path.unlink(missing_ok=True)
            for end in (self._master, self._slave):
                with contextlib.suppress(OSError):
                    os.close(end)
            self._master = self._slave = -1
