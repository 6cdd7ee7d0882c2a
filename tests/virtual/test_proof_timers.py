"""Operators, recorders and supervisors in virtual time: many more trials than a test of every day plays."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.episode.recorder import test_recorder_in_virtual_time as recorders
from tests.figures import Figures
from tests.operator import test_dead_man_in_virtual_time as dead_man
from tests.supervision import test_restarts_in_virtual_time as restarts

FIRST = 1_000_000
"""Seed; those before are played every day."""

pytestmark = pytest.mark.timeout(3600)


def test_no_operator_of_a_thousand_drives_without_a_fresh_held_enable(proof: Figures) -> None:
    for seed in range(FIRST, FIRST + 1_000):
        dead_man.play(seed)
    proof.figure("sessions of an operator through faults, in virtual time", 1_000, "trials", "no breach")


def test_no_recorder_of_hundreds_loses_an_episode_or_what_it_lacks(proof: Figures, tmp_path: Path) -> None:
    for seed in range(FIRST, FIRST + 500):
        recorders.play(seed, tmp_path / str(seed))
    proof.figure("recorders through faults of their bus, in virtual time", 500, "trials", "no breach")


def test_no_server_of_thousands_is_forgotten_or_started_too_often(proof: Figures, tmp_path: Path) -> None:
    for seed in range(FIRST, FIRST + 3_000):
        restarts.play(seed, tmp_path / str(seed))
    proof.figure("stations whose servers die, in virtual time", 3_000, "trials", "no breach")
