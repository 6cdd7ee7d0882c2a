"""A scripted spacemouse: the HID reports that a real one would send, by a clock.

{"device": "spacemouse", "model": …, "steps": [
    {"at_s": 0.5, "twist": [0.5, 0, 0, 0, 0, 0]},      the cap is held there: a report every 16 ms from now on
    {"at_s": 1.0, "twist": [0, 0, 0, 0, 0, 0]},        it is let go: one report of rest, then silence
    {"at_s": 1.2, "buttons": [0]},                     which buttons are pressed
    {"at_s": 2.0, "report": "01 5e 01 00 00 00 00"},   any report
    {"at_s": 3.0, "plugged": false}, {"at_s": 4.0, "plugged": true}]}
"""

from __future__ import annotations

import math
import time
from collections import deque

import numpy as np

from adapters.devices.fakes.script import Clock, Play, Script, Step
from adapters.devices.spacemouse.models import MODELS, MOTION_USAGE
from adapters.devices.spacemouse.reports import encode_buttons, encode_motion

REPEAT_S = 0.016
"""How often a spacemouse reports while a hand is on the cap."""

_ROUNDING_S = 1e-9
COMPACT = (0x256F, 0xC635)


class MouseStep(Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a spacemouse may do.

    Attributes:
        twist: Where the cap is held from now on, vx vy vz wx wy wz in FLU, each -1..1 of full deflection.
        buttons: The buttons that are pressed from now on.
        report: The bytes of a report, in hexadecimal digits.
        plugged: Whether it is plugged in from now on.
    """

    twist: tuple[float, float, float, float, float, float] | None = None
    buttons: list[int] | None = None
    report: str | None = None
    plugged: bool | None = None

    def __post_init__(self) -> None:
        if self.report is not None:
            bytes.fromhex(self.report)  # its ValueError is the message
        if any(not 0 <= bit < 48 for bit in self.buttons or ()):
            raise ValueError("buttons are bits from 0 to 47")


class FakeMouse:
    """A spacemouse that plays a script; one HID interface.

    Args:
        script: What it does.
        clock: Tells the time [s].
        model: Its vendor and product.
        serial: Its serial number.
        path: Its name on this machine.
        number: Number of its interface.
        denied: Whether it may not be opened.
        start_s: Time of the script to begin at, with the first look [s].
    """

    def __init__(
        self,
        script: Script[MouseStep],
        clock: Clock = time.monotonic,
        *,
        model: tuple[int, int] = COMPACT,
        serial: str = "FAKE-1",
        path: str = "/dev/hidraw-fake",
        number: int = 0,
        denied: bool = False,
        start_s: float = 0.0,
    ) -> None:
        self.vendor_id, self.product_id = model
        self.name, self.serial, self.path, self.number, self.denied = MODELS[model].name, serial, path, number, denied
        self.usage = MOTION_USAGE
        self._in_one = MODELS[model].in_one_report
        self._play, self._start_s = Play(script, clock), start_s
        self._held: list[bytes] = []
        self._pressed: list[int] = []
        self._repeat_at_s = math.inf
        self._reports: deque[bytes] = deque()
        self._is_plugged, self._was_torn_out = True, False

    @property
    def is_there(self) -> bool:
        """Whether it is plugged in."""
        if self._play.has_begun:
            self._catch_up()
        self._was_torn_out = False  # whoever looks for it now opens it anew
        return self._is_plugged

    def next_report(self) -> bytes | None:
        """Return the oldest report that was not read, b"" when there is none, None when it is torn out."""
        self._catch_up()
        if self._was_torn_out:
            return None
        return self._reports.popleft() if self._reports else b""

    def _catch_up(self) -> None:
        """Do what is due by now, in the order of time."""
        if not self._play.has_begun and self._start_s > 0.0:
            self._begin_midway()
        self._do_until(self._play.time_s())

    def _begin_midway(self) -> None:
        """Bring everything to where the script stands; of what was reported before that nothing is left."""
        self._play.begin(self._start_s)
        self._do_until(self._start_s)
        self._reports.clear()
        self._was_torn_out = False
        if self._is_plugged and self._pressed:
            self._reports.append(encode_buttons(self._pressed))

    def _do_until(self, now_s: float) -> None:
        for at_s, step in self._play.due(now_s):
            self._hold_until(at_s - _ROUNDING_S)
            self._do(at_s, step)
        self._hold_until(now_s)

    def _do(self, at_s: float, step: MouseStep) -> None:
        if step.plugged is not None:
            self._was_torn_out |= self._is_plugged and not step.plugged
            self._is_plugged, self._repeat_at_s = step.plugged, math.inf
            self._reports.clear()
        if step.twist is not None and self._is_plugged:
            self._held = encode_motion(np.array(step.twist), in_one=self._in_one)
            self._reports.extend(self._held)
            self._repeat_at_s = at_s + REPEAT_S if any(step.twist) else math.inf
        if step.buttons is not None and self._is_plugged:
            self._pressed = step.buttons
            self._reports.append(encode_buttons(step.buttons))
        if step.report is not None and self._is_plugged:
            self._reports.append(bytes.fromhex(step.report))

    def _hold_until(self, until_s: float) -> None:
        """Send again what a held cap sends."""
        while self._repeat_at_s <= until_s + _ROUNDING_S / 2:
            self._reports.extend(self._held)
            self._repeat_at_s += REPEAT_S
