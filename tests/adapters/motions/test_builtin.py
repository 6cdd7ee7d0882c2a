"""Motions without a file."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.motions.load import load
from adapters.robots.g1.joints import JOINTS
from station.errors import UnknownName


@pytest.mark.parametrize("name", ["wave", "squat"])
def test_a_built_in_motion_loads_like_a_file_and_stays_within_the_joints(name: str) -> None:
    clip = load(f"builtin:{name}")
    assert clip.duration_s > 5.0
    facts = clip.facts()
    assert facts["file"] == f"builtin:{name}"
    assert len(facts["sha256"]) == 64
    np.testing.assert_allclose(clip.at(0.0).q, clip.at(clip.duration_s).q, atol=0.05)
    every = np.array([clip.at(time_s).q for time_s in np.linspace(0.0, clip.duration_s, 200)])
    assert (every.min(axis=0) >= [joint.lower for joint in JOINTS]).all()
    assert (every.max(axis=0) <= [joint.upper for joint in JOINTS]).all()


def test_an_unknown_one_says_which_there_are() -> None:
    with pytest.raises(
        UnknownName, match=r"unknown built-in motion 'wav' \(did you mean 'wave'\?\); known: squat, wave"
    ):
        load("builtin:wav")
