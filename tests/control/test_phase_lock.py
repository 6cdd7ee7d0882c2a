"""Ticks move to just behind the commands that they use; commanders at other rates leave them where they are."""

from __future__ import annotations

from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.control.phase_lock import PhaseLock
from station.protocols import Floats

PERIOD_S = 0.02
USUAL_S = 0.001


class Run:
    """A loop of 50 Hz beside a commander.

    Args:
        offset_s: From a tick to the command after it, at first [s].
        command_hz: The commander's rate [Hz].
        scatter_s: Standard deviation of the arrivals [s].
        seconds: Length.
        sources: Writers that write in turn.

    Attributes:
        ticks_s: When ticks were [s].
        ages_s: Of the command that each tick used; only where it was new [s].
        lock: The lock.
    """

    def __init__(
        self, offset_s: float, command_hz: float = 50.0, scatter_s: float = 0.0, seconds: float = 12.0,
        sources: tuple[str, ...] = ("motion",),
    ) -> None:  # fmt: skip
        random, lock = Random(1), PhaseLock(PERIOD_S)
        arrivals = [offset_s + n / command_hz + random.gauss(0.0, scatter_s) for n in range(int(seconds * command_hz))]
        self.ticks_s, self.ages_s, self.lock = list[float](), list[float](), lock
        tick_s, used = 0.0, -1
        while tick_s < seconds - 1.0:
            self.ticks_s.append(tick_s)
            newest = max((n for n in range(used, len(arrivals)) if n >= 0 and arrivals[n] <= tick_s), default=used)
            if newest > used:
                used = newest
                self.ages_s.append(tick_s - arrivals[newest])
                tick_s += lock.on_tick(sources[newest % len(sources)], self.ages_s[-1])
            tick_s += PERIOD_S

    def late_ages_s(self) -> Floats:
        """Return ages of the last third [s]."""
        return np.array(self.ages_s[-len(self.ages_s) // 3 :])


@pytest.mark.parametrize("command_hz", [12.5, 25.0, 50.0, 100.0, 250.0, 49.98, 50.02])
@pytest.mark.parametrize("offset_s", [0.0001, 0.004, 0.0127, 0.0199])
def test_a_command_at_the_loop_s_rate_or_a_multiple_is_used_just_after_it_came(
    offset_s: float, command_hz: float
) -> None:
    run = Run(offset_s, command_hz, seconds=12.0 * max(1.0, 50.0 / command_hz))
    assert run.lock.is_locked
    assert np.all(run.late_ages_s() < 2 * USUAL_S)
    assert np.all(run.late_ages_s() > 0.0)


@given(offset_s=st.floats(0.0, PERIOD_S), scatter_s=st.floats(0.0, 0.0005))
def test_arrivals_that_scatter_are_waited_for(offset_s: float, scatter_s: float) -> None:
    ages_s = Run(offset_s, scatter_s=scatter_s).late_ages_s()
    assert np.median(ages_s) < 0.0025
    assert np.mean(ages_s < PERIOD_S / 2) > 0.94, "few come after their tick and wait for the next"


@pytest.mark.parametrize("command_hz", [30.0, 45.0, 49.0, 49.8, 50.2, 51.0, 72.0, 90.0, 97.0])
def test_a_commander_at_another_rate_does_not_pull_the_loop_along(command_hz: float) -> None:
    run = Run(0.004, command_hz, seconds=30.0)
    rate_hz = (len(run.ticks_s) - 1) / (run.ticks_s[-1] - run.ticks_s[0])
    assert rate_hz == pytest.approx(50.0, rel=0.002)


@given(
    offset_s=st.floats(0.0, PERIOD_S), command_hz=st.floats(5.0, 300.0), scatter_s=st.floats(0.0, 0.02),
    writers=st.integers(1, 3),
)  # fmt: skip
def test_whatever_comes_no_period_changes_by_more_than_a_hundredth(
    offset_s: float, command_hz: float, scatter_s: float, writers: int
) -> None:
    run = Run(offset_s, command_hz, scatter_s, seconds=6.0, sources=("a", "b", "c")[:writers])
    periods_s = np.array([b - a for a, b in pairwise(run.ticks_s)])
    assert np.all(np.abs(periods_s / PERIOD_S - 1.0) < 0.0101)
