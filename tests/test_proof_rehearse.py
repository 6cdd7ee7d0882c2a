"""Promises about physics that take minutes of it: all motions, all clips, all models."""

from __future__ import annotations

import pytest

from adapters.motions import builtin
from tests.adapters.motions.test_builtin_rehearsed import assert_done
from tests.adapters.robots.test_g1_contacts import MOTIONS, assert_tracked_as_well
from tests.figures import Figures
from tests.test_rehearse import AS_UPSTREAM, UPSTREAM, assert_all_end_well

pytestmark = [pytest.mark.assets, pytest.mark.usefixtures("assets"), pytest.mark.timeout(600)]


def test_all_motions_of_twist2_end_well_with_the_step_that_it_simulates_with(proof: Figures) -> None:
    assert_all_end_well(UPSTREAM, AS_UPSTREAM, 0.001)
    proof.figure(
        "motions of TWIST2 rehearsed with TWIST2's policy and model, falls", f"0 of {len(UPSTREAM)}", limit="0"
    )


def test_the_policy_of_twist2_does_every_clip_without_a_fall(proof: Figures) -> None:
    assert_done("twist2", builtin.names())
    proof.figure("built-in clips with TWIST2's policy, falls", f"0 of {len(builtin.names())}", limit="0")


def test_twist2_tracks_all_six_motions_as_well_as_with_the_meshed_robot(proof: Figures) -> None:
    assert_tracked_as_well(MOTIONS)
