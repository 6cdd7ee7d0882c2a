"""Histories by seed, many more than a test of every day plays."""

from __future__ import annotations

import pytest

from tests.figures import Figures
from tests.virtual.trial import play

TRIALS = 3_000


@pytest.mark.timeout(3600)
def test_no_history_of_thousands_breaks_what_must_hold_in_every_tick(proof: Figures) -> None:
    for seed in range(1_000_000, 1_000_000 + TRIALS):
        play(seed, lasts_s=3.0)
    proof.figure("histories in virtual time without a breach, by seed", TRIALS, "trials", "no breach")
