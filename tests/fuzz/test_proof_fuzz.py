"""A million mutants, and every token at every place of every good value."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from station.episode.reading.reader import open_episode
from station.errors import StationError
from tests.figures import Figures
from tests.fuzz import campaign
from tests.fuzz.readers import READERS, episode_of_mutants

CASES = 1_000_000
EPISODES = 50
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of arithmetic with huge numbers; it ends nobody


@pytest.mark.timeout(7200)
def test_a_million_mutants_end_nothing_that_reads_values(proof: Figures) -> None:
    outcome = campaign.run(CASES, campaign.seed())
    assert not outcome.findings, str(outcome)
    proof.figure("random values that ended something that reads the bus", f"0 of {CASES}", limit="0")


@pytest.mark.timeout(3600)
def test_every_token_at_every_place_ends_nothing_that_reads_values(proof: Figures) -> None:
    outcome = campaign.sweep()
    assert not outcome.findings, str(outcome)


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("number", range(EPISODES))
def test_no_recorded_mutant_ends_a_reader_of_episodes(proof: object, number: int, tmp_path: Path) -> None:
    folder = episode_of_mutants(tmp_path, 100, f"{campaign.seed()}/{number}")
    for reader in READERS:
        with contextlib.suppress(StationError):
            reader.read(open_episode(folder))
