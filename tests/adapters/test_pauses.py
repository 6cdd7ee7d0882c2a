"""A process that stood still takes what waited as old, whether it stood still in its wait or between two."""

from __future__ import annotations

import pytest

from adapters.pauses import Pauses
from station.clock import Clock


class Hands(Clock):
    """A clock that is moved by hand."""

    now_ns = 10**9

    def monotonic_ns(self) -> int:
        return self.now_ns

    def move(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


def look(clock: Hands, pauses: Pauses, *, before_s: float = 0.0, waited_s: float = 0.0, messages: int = 1) -> float:
    """Look once; return when the last message came, on the clock that begins at 1 s."""
    clock.move(before_s)
    pauses.begin()
    clock.move(waited_s)
    pauses.end(0.02)
    came_s = [pauses.came_s() for _ in range(messages)]
    pauses.done(is_empty=True)
    return came_s[-1] if came_s else -1.0


def test_what_is_read_in_time_came_now() -> None:
    clock = Hands()
    pauses = Pauses(clock)
    assert look(clock, pauses, waited_s=0.02) == pytest.approx(1.02)
    assert look(clock, pauses, before_s=0.09, waited_s=0.02) == pytest.approx(1.13)


@pytest.mark.parametrize(("pause", "came_s"), [({"waited_s": 3.0}, 1.02), ({"before_s": 3.0}, 1.02)])
def test_what_waited_for_a_process_that_stood_still_came_before_that(pause: dict[str, float], came_s: float) -> None:
    clock = Hands()
    pauses = Pauses(clock)
    look(clock, pauses, waited_s=0.02)
    assert look(clock, pauses, **pause) == pytest.approx(came_s)
    assert look(clock, pauses, waited_s=0.01) == pytest.approx(came_s), "a library still hands over what waited"
    look(clock, pauses, before_s=0.03, waited_s=0.02, messages=0)
    assert look(clock, pauses, waited_s=0.01) == pytest.approx(clock.monotonic_s())
