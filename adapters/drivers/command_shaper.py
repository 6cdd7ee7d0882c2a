"""The last thing that happens to a command: it goes on from the one before it, within ranges and rates."""

from __future__ import annotations

import numpy as np

from adapters.motions.builtin.profiles import rise
from station.protocols import CommandFormat, Floats

ENTER_S = 1.0
"""From a command that stands to what a driver wants [s], as in stock TWIST2."""


class CommandShaper:
    """Commands that go on where the last one was, whatever is wanted.

    Args:
        command_format: Of the commands; begins at its default.

    Attributes:
        sent: The command that stands, shape (m,).
    """

    def __init__(self, command_format: CommandFormat) -> None:
        self.command_format = command_format
        self.sent: Floats = np.array(command_format.default)
        self._offset: Floats | None = None  # what was sent more than was wanted, when a way began; None before it does
        self._begun_s, self._lasts_s = 0.0, np.ones(len(self.sent))

    def resume_from(self, command: Floats) -> None:
        """Go on from another writer's command, shape (m,)."""
        self.sent = np.clip(command, self.command_format.lower, self.command_format.upper)
        self.begin()

    def begin(self, seconds: Floats | float = ENTER_S) -> None:
        """Begin a way of so long from the command that stands to what is wanted from now on, wherever that moves.

        Args:
            seconds: Time that it takes, of all elements or of each, shape (m,) [s].
        """
        self._offset, self._begun_s, self._lasts_s = None, 0.0, np.broadcast_to(seconds, self.sent.shape)

    def send(self, wanted: Floats, dt_s: float) -> Floats:
        """Return the command that follows the last one after a period [s]; the first after `begin` is the last one."""
        if self._offset is None:
            self._offset = self.sent - wanted
            return self.sent.copy()
        self._begun_s += dt_s
        left = 1.0 - rise(self._begun_s / self._lasts_s, 0.0, 1.0)
        command = np.clip(wanted + left * self._offset, self.command_format.lower, self.command_format.upper)
        change = self.command_format.rate * dt_s
        self.sent = np.clip(command, self.sent - change, self.sent + change)
        return self.sent.copy()
