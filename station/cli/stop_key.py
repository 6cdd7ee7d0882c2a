"""The emergency stop as a key of ``station up``: says what became of each press, and does not give up."""

from __future__ import annotations

import time
from collections.abc import Callable

from station.errors import BusError
from station.life.events import Severity
from station.life.stop_button import StopButton

KEYS = (" ", "e", "E")
HINT = "SPACE or e: emergency stop"

_REPEATS_S = 1.0  # a key that is held down repeats thirty times a second


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
            self._button.press("key in `station up`")
        except BusError as error:
            self._say(f"EMERGENCY STOP: {error}; this station's own servers were told directly; trying on", "error")
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
            self._button.press("key in `station up`, late")
        except BusError:
            return
        late_s, self._pressed_s = time.monotonic() - self._pressed_s, None
        self._say(f"EMERGENCY STOP: taken {late_s:.1f} s after the key; the robots are damped", "error")
