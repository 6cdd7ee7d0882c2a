"""A clock that stands still until a test moves it."""

from __future__ import annotations


class HandClock:
    """Tells the time [s] that a test has set."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def pass_(self, seconds: float) -> None:
        self.now_s += seconds
