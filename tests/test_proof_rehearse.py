"""Promises about physics that take minutes of it: all motions, all clips, all models."""

from __future__ import annotations

import pytest

from adapters.motions import builtin
from tests.adapters.motions.test_builtin_rehearsed import assert_done
from tests.adapters.robots.test_g1_contacts import MOTIONS, assert_tracked_as_well
from tests.figures import Figures
from tests.test_rehearse import ALL_OF_TWIST2, AS_UPSTREAM, assert_all_end_well

pytestmark = [pytest.mark.assets, pytest.mark.usefixtures("assets"), pytest.mark.timeout(600)]


@pytest.mark.parametrize("physics_dt_s", [0.001, 0.002])
def test_all_motions_of_twist2_end_well(proof: Figures, physics_dt_s: float) -> None:
    assert_all_end_well(ALL_OF_TWIST2, AS_UPSTREAM, physics_dt_s)
    what = f"motions of TWIST2 with its policy and model, in steps of {physics_dt_s * 1e3:g} ms: falls"
    proof.figure(what, f"0 of {len(ALL_OF_TWIST2)}", limit="0")


@pytest.mark.parametrize("policy", ["tracker", "twist2"])
def test_a_policy_does_every_clip_without_a_fall(proof: Figures, policy: str) -> None:
    assert_done(policy, builtin.names())
    proof.figure(f"built-in clips with the policy {policy}: falls", f"0 of {len(builtin.names())}", limit="0")


def test_twist2_tracks_all_six_motions_as_well_as_with_the_meshed_robot(proof: Figures) -> None:
    assert_tracked_as_well(MOTIONS)
