"""Live, stale and lost follow the device's own time stamps, whatever the rate at which they are looked at."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.operator.sample import OperatorSample
from station.operator.serve import Freshness

TICK_S = 0.01


def at(capture_ns: int | None) -> OperatorSample:
    return OperatorSample(capture_ns=capture_ns)


def live() -> tuple[Freshness, float]:
    """Return a freshness that is live, and the time of its newest sample [s]."""
    freshness = Freshness()
    for tick in range(20):
        freshness.step(tick * TICK_S, at(tick))
    assert freshness.state == "live"
    return freshness, 19 * TICK_S


def test_it_is_lost_until_samples_have_flowed_for_a_moment() -> None:
    freshness = Freshness()
    assert not freshness.step(0.0, None)
    assert freshness.state == "lost"
    states = []
    for tick in range(1, 15):
        assert freshness.step(tick * TICK_S, at(tick))
        states.append(freshness.state)
    assert states[:10] == ["lost"] * 10
    assert states[10:] == ["live"] * 4


def test_an_unchanged_time_stamp_is_no_new_sample() -> None:
    freshness, now_s = live()
    assert not freshness.step(now_s + 0.01, at(19))
    assert (freshness.new, freshness.repeated) == (20, 1)
    assert freshness.step(now_s + 0.02, at(20))
    assert (freshness.new, freshness.repeated) == (21, 1)


@pytest.mark.parametrize(
    ("silence_s", "state"), [(0.09, "live"), (0.11, "stale"), (0.99, "stale"), (1.01, "lost"), (1e6, "lost")]
)
def test_silence_makes_it_stale_and_then_lost(silence_s: float, state: str) -> None:
    freshness, now_s = live()
    freshness.step(now_s + silence_s, at(19))
    assert freshness.state == state


def test_a_device_that_sends_too_slowly_is_stale_and_does_not_flap() -> None:
    freshness, now_s = live()
    seen = []
    for tick in range(1, 500):
        freshness.step(now_s + tick * TICK_S, at(20 + tick // 12))  # a sample every 120 ms
        seen.append(freshness.state)
    assert seen[20:] == ["stale"] * (len(seen) - 20)


def test_a_device_without_a_clock_is_fresh_whenever_it_answers() -> None:
    freshness = Freshness()
    for tick in range(20):
        assert freshness.step(tick * TICK_S, at(None))
    assert freshness.state == "live"


def test_a_device_that_says_it_is_gone_is_lost_at_once_and_must_settle_again() -> None:
    freshness, now_s = live()
    freshness.lose()
    assert freshness.state == "lost"
    freshness.step(now_s + TICK_S, at(99))
    assert freshness.state == "lost"


@given(st.lists(st.tuples(st.floats(0.001, 2.0), st.booleans()), max_size=60))
def test_it_is_never_live_after_a_long_silence_nor_lost_while_samples_flow(steps: list[tuple[float, bool]]) -> None:
    freshness, now_s, newest_s, flowing_since_s, capture = Freshness(), 0.0, None, 0.0, 0
    for gap_s, has_sample in steps:
        now_s += gap_s
        if has_sample:
            capture += 1
            if newest_s is None or now_s - newest_s > 0.1:
                flowing_since_s = now_s
            newest_s = now_s
        freshness.step(now_s, at(capture) if capture else None)
        if newest_s is None or now_s - newest_s > 1.0:
            assert freshness.state == "lost"
        elif now_s - newest_s > 0.1:
            assert freshness.state != "live"
        elif newest_s - flowing_since_s >= 0.1:
            assert freshness.state == "live"
