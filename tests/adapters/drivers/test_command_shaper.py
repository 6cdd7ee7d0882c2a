"""A command goes on from the one before it, whatever is wanted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.commands.twist2 import FORMAT
from adapters.drivers.command_shaper import CommandShaper

TICK_S = 0.01


def wild(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.uniform(FORMAT.lower - 1.0, FORMAT.upper + 1.0)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 30), st.booleans()), min_size=1, max_size=10))
def test_whatever_is_wanted_ranges_and_rates_are_kept(wishes: list[tuple[int, int, bool]]) -> None:
    shaper, before = CommandShaper(FORMAT), np.array(FORMAT.default)
    for seed, ticks, begins in wishes:
        if begins:
            shaper.begin()
        for _ in range(ticks):
            command = shaper.send(wild(seed), TICK_S)
            assert (command >= FORMAT.lower).all()
            assert (command <= FORMAT.upper).all()
            assert (np.abs(command - before) <= FORMAT.rate * TICK_S + 1e-12).all()
            before = command


def test_the_first_command_is_the_one_that_stands_and_a_second_later_all_is_as_wanted() -> None:
    shaper = CommandShaper(FORMAT)
    shaper.resume_from(np.clip(wild(1), FORMAT.lower, FORMAT.upper))
    standing, wanted = shaper.sent, np.array(FORMAT.default)
    assert shaper.send(wanted, TICK_S) == pytest.approx(standing, abs=0.0)
    assert shaper.send(wanted, TICK_S) == pytest.approx(standing, abs=1e-3)
    for _ in range(100):
        command = shaper.send(wanted, TICK_S)
    assert command == pytest.approx(wanted, abs=0.0)


def test_a_command_out_of_range_is_taken_up_at_the_end_of_it() -> None:
    shaper = CommandShaper(FORMAT)
    shaper.resume_from(FORMAT.upper + 5.0)
    assert shaper.sent == pytest.approx(FORMAT.upper)
