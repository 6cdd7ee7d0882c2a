"""Velocities of a command on their way to zero where commands are lost, and back where commands return. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from station.protocols import Floats

_ROUNDING = 1e-9


class VelocityFade:
    """A linear way from some velocities to those of a goal that may move; all other elements are left alone.

    Args:
        elements: Indices of the velocities within a command.
        duration_s: Time that it takes [s].
    """

    def __init__(self, elements: Sequence[int], duration_s: float) -> None:
        self._elements, self._duration_s = list(elements), duration_s
        self._start: Floats | None = None  # None: nothing fades
        self._passed_s = 0.0

    @property
    def has_velocities(self) -> bool:
        """Whether there is anything to fade."""
        return bool(self._elements)

    def begin(self, start: Floats) -> None:
        """Begin anew from the velocities of a command, shape (m,)."""
        self._start, self._passed_s = start, 0.0

    def end(self) -> None:
        """Leave velocities alone from now on."""
        self._start = None

    def apply(self, wanted: Floats, goal: Floats, passed_s: float) -> Floats:
        """Return a command with its velocities as they are after a further period.

        Args:
            wanted: The command, shape (m,); not changed.
            goal: Where its velocities are going, shape (m,).
            passed_s: The period [s].
        """
        if self._start is None or not self._elements:
            return wanted
        self._passed_s += passed_s
        part = self._passed_s / self._duration_s
        start, end = self._start[self._elements], goal[self._elements]
        wanted = wanted.copy()
        wanted[self._elements] = end if part >= 1.0 - _ROUNDING else start + part * (end - start)
        return wanted
