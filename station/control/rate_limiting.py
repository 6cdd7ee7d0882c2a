"""Tells when a command begins to be slewed, and when that has ended, rather than in every tick. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from station.protocols import CommandFormat

_CALM_S = 0.5  # a command on the edge of what is allowed is slewed now and then; that is one story


class RateLimiting:
    """Follows which elements a gate limits.

    Args:
        form: Names the elements.
    """

    def __init__(self, form: CommandFormat) -> None:
        self._form = form
        self._ticks = 0
        self._elements: set[int] = set()
        self._last_s = 0.0

    def note(self, limited: tuple[int, ...], now_s: float) -> Iterator[tuple[str, dict[str, Any]]]:
        """Record a tick; yield name and detail of an event when slewing begins and when it has ended."""
        if limited:
            if not self._ticks:
                yield "command-slewed", {"elements": self._names(limited)}
            self._ticks, self._last_s = self._ticks + 1, now_s
            self._elements.update(limited)
        elif self._ticks and not 0.0 <= now_s - self._last_s < _CALM_S:
            yield "command-slewed", {"ended": True, "ticks": self._ticks, "elements": self._names(self._elements)}
            self._ticks, self._elements = 0, set()

    def _names(self, indices: tuple[int, ...] | set[int]) -> list[str]:
        return [self._form.elements[index].name for index in sorted(indices)]
