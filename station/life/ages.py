"""How old what a bridge passed on was."""

from __future__ import annotations

import statistics
from collections import deque
from typing import Any

_KEPT = 200  # whose median is told


class Ages:
    """Of the newest few."""

    def __init__(self) -> None:
        self._kept: deque[float] = deque(maxlen=_KEPT)

    def add(self, age_ms: float) -> None:
        """Add an age [ms]."""
        self._kept.append(age_ms)

    def facts(self, name: str) -> dict[str, Any]:
        """Return the median and the greatest [ms], if there is any."""
        kept = list(self._kept)
        return {name: [round(statistics.median(kept), 3), round(max(kept), 3)]} if kept else {}
