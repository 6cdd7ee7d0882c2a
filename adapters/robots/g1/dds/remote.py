"""A G1's remote: the forty bytes in each state. Source: ``unitree_joystick.hpp`` of unitreerobotics/unitree_sdk2."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds.buttons import BUTTONS

STOPS = (frozenset({"select"}), frozenset({"L2", "B"}))
"""Buttons that stop while they are held together, whatever else is held."""

_DEBOUNCE = 2  # messages: one damaged frame has pressed A on a real robot
_HEAD = (0x55, 0x51)


class Sticks(NamedTuple):
    """Where the sticks are, -1 to 1: right and up are positive."""

    left_x: float
    left_y: float
    right_x: float
    right_y: float


class Remote:
    """Follows the remote from message to message.

    Attributes:
        held: Buttons that are down in `_DEBOUNCE` messages in a row.
        sticks: Where the sticks are.
        is_on: Whether the newest message was of a remote that is on.
    """

    def __init__(self) -> None:
        self.held: frozenset[str] = frozenset()
        self.sticks = Sticks(0.0, 0.0, 0.0, 0.0)
        self.is_on = False
        self._last: list[frozenset[str]] = []
        self._pressed: list[str] = []

    def update(self, messages: Iterable[NDArray[np.uint8]]) -> None:
        """Take the bytes of messages, oldest first, shape (40,) each; those with another head do not count."""
        for data in messages:
            self.is_on = bool(data.any())
            is_sound = tuple(data[:2]) in (_HEAD, (0, 0))
            if self.is_on and not is_sound:
                continue
            bits = int(data[2]) | int(data[3]) << 8
            self._last = [*self._last[1 - _DEBOUNCE :], frozenset(n for i, n in enumerate(BUTTONS) if bits >> i & 1)]
            if len(self._last) < _DEBOUNCE:
                continue
            held = frozenset.intersection(*self._last)
            self._pressed += sorted(held - self.held)
            self.held = held
            numbers = data.view("<f4")
            self.sticks = Sticks(float(numbers[1]), float(numbers[5]), float(numbers[2]), float(numbers[3]))

    @property
    def stop(self) -> str:
        """The buttons that stop the robot now: ``L2+B``; "" for none."""
        return next(("+".join(sorted(stop, reverse=True)) for stop in STOPS if stop <= self.held), "")

    def pop_pressed(self) -> list[str]:
        """Return the buttons that went down since the last call."""
        pressed, self._pressed = self._pressed, []
        return pressed
