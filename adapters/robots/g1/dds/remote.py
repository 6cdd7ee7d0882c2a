"""A G1's remote: the forty bytes in each state. Source: ``unitree_joystick.hpp`` of unitreerobotics/unitree_sdk2."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds.buttons import BUTTONS

STOPS = (frozenset({"select"}), frozenset({"L2", "B"}))
"""Buttons that stop while they are held together, whatever else is held."""

_HEADS = (0x5155, 0)  # as it is on air; the second of a remote that is off, or of firmware that sends none


class Sticks(NamedTuple):
    """Where the sticks are, -1 to 1: right and up are positive."""

    left_x: float
    left_y: float
    right_x: float
    right_y: float


def remote_bytes(held: Iterable[str], sticks: Sticks) -> NDArray[np.uint8]:
    """Return the bytes of a remote that is on, shape (40,)."""
    data = np.zeros(40, np.uint8)
    data[:2].view("<u2")[0] = _HEADS[0]
    data[2:4].view("<u2")[0] = sum(1 << BUTTONS.index(name) for name in set(held))
    data.view("<f4")[[1, 5, 2, 3]] = sticks
    return data


class Remote:
    """Follows the remote from message to message.

    Attributes:
        held: Buttons that are down in two messages in a row: one damaged message has pressed A on a real robot.
        sticks: Where the sticks are.
        is_on: Whether the newest message was of a remote that is on.
    """

    def __init__(self) -> None:
        self.held: frozenset[str] = frozenset()
        self.sticks = Sticks(0.0, 0.0, 0.0, 0.0)
        self.is_on = False
        self._bits = self._last = 0
        self._settled = b""  # the newest message, where another of its kind changes nothing
        self._pressed: list[str] = []

    def update(self, remotes: NDArray[np.uint8]) -> None:
        """Take the bytes of messages, oldest first, shape (k, 40); those with another head do not count."""
        data, length = remotes.tobytes(), remotes.shape[1]
        newest = data[-length:]
        if newest == self._settled and data == newest * len(remotes):
            return  # nothing is touched, as most of the time
        self.is_on = bool(remotes[-1].any())
        heads, bits = remotes[:, :2].view("<u2")[:, 0].tolist(), remotes[:, 2:4].view("<u2")[:, 0].tolist()
        for head, came in zip(heads, bits, strict=True):
            if head not in _HEADS:
                continue
            both, self._last = came & self._last, came
            if both != self._bits:
                self._change(both)
        left_x, right_x, right_y, _, left_y = remotes[-1].view("<f4")[1:6].tolist()
        self.sticks = Sticks(left_x, left_y, right_x, right_y)
        self._settled = newest if self._bits == self._last else b""

    def _change(self, bits: int) -> None:
        held = frozenset(name for number, name in enumerate(BUTTONS) if bits >> number & 1)
        self._pressed += sorted(held - self.held)
        self._bits, self.held = bits, held

    @property
    def stop(self) -> str:
        """The buttons that stop the robot now: ``L2+B``; "" for none."""
        return next(("+".join(sorted(stop, reverse=True)) for stop in STOPS if stop <= self.held), "")

    def pop_pressed(self) -> list[str]:
        """Return the buttons that went down since the last call."""
        pressed, self._pressed = self._pressed, []
        return pressed
