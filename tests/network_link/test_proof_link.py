"""How exact the cable is by which other promises are measured: one-way delays, and what it adds by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from statistics import median

import pytest

from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.network_link.link import Link
from tests.network_link.probes import Probes

PROBES, EVERY_S = 250, 0.02  # as commands go: 50 a second
DELAY_S, JITTER_S, LOSS = 0.005, 0.01, 0.01
ADDED_S, SPREAD_S = 0.001, 0.002


@pytest.fixture
def link(network_links: None) -> Iterator[Link]:
    with Link(("192.168.123.164", "192.168.123.222"), seed=1) as laid:
        yield laid


def _took_s(link: Link, *, delay_s: float, jitter_s: float = 0.0, loss: float = 0.0) -> list[float]:
    """Return how long each of `PROBES` took, those aside that were lost, shortest first."""
    link.change()
    with Probes(link, *link.ends) as probes:
        probes.greet()
        link.change(delay_s=delay_s, jitter_s=jitter_s, loss=loss)
        probes.send(PROBES, EVERY_S)
    return sorted(arrival.took_s for arrival in probes.arrivals[1:])


def _within(measure: Callable[[], list[float]], low_s: float, high_s: float) -> list[float]:
    """Return a measurement whose median is within bounds; another one where the machine was late."""

    def trial() -> list[float]:
        with Waits.watched() as waits:
            took_s = measure()
        if median(took_s) > high_s:
            raise TooLate("probes", median(took_s) - high_s, waits.longest_s)
        return took_s

    took_s = in_time(trial)
    assert low_s <= median(took_s) <= high_s
    return took_s


def test_half_of_all_datagrams_take_the_delay_that_was_asked_for(proof: Figures, link):
    took_s = _within(lambda: _took_s(link, delay_s=DELAY_S), DELAY_S, DELAY_S + ADDED_S)
    assert len(took_s) == PROBES
    proof.figure(
        "one way over the emulated cable, 5 ms asked for, half of 250", median(took_s) * 1e3, "ms", "5 to 6 ms"
    )
    at_once_s = _within(lambda: _took_s(link, delay_s=0.0), 0.0, ADDED_S)
    proof.figure("one way over the emulated cable, none asked for, half of 250", median(at_once_s) * 1e3, "ms", "1 ms")


def test_a_bad_line_is_as_bad_as_was_asked_for(proof: Figures, link):
    took_s = _within(
        lambda: _took_s(link, delay_s=DELAY_S, jitter_s=JITTER_S, loss=LOSS), DELAY_S - SPREAD_S, DELAY_S + SPREAD_S * 2
    )
    assert 0.015 < took_s[int(0.9 * len(took_s))] < 0.025, "the ninth of ten: 5 ms and 1.28 standard deviations"
    assert PROBES - 10 <= len(took_s) <= PROBES, "of 250 draws 2.5 are lost, 10 by a chance of 1 in 10 000"
    ninth = took_s[int(0.9 * len(took_s))]
    proof.figure("one way over a line of 5 ms ± 10 ms, nine of ten", ninth * 1e3, "ms", "15 to 25 ms")
