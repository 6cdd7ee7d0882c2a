"""A clock that stands still until a test moves it."""

from __future__ import annotations

from station.clock import Clock


class HandClock(Clock):
    """Tells the time that a test has set: as a `Clock`, and as the function [s] that scripts take."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def monotonic_ns(self) -> int:
        return round(self.now_s * 1e9)

    def pass_(self, seconds: float) -> None:
        self.now_s += seconds

    def sleep_until(self, instant_ns: int) -> None:
        self.now_s = max(self.now_s, instant_ns * 1e-9)
