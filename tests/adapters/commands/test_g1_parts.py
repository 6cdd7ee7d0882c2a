"""The command of a G1 whose legs and arms are commanded apart, as motions ask for it."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.commands.g1_parts import ARMS, VELOCITY_POSTURE
from adapters.motions import velocities
from adapters.motions.load import load
from station.errors import ConfigError


def test_a_script_of_velocities_walks_the_legs_and_leaves_the_arms() -> None:
    script = velocities.script("velocity:forward")
    vector = VELOCITY_POSTURE.encode(script.at(script.duration_s / 2), script.joint_names)
    assert vector[0] > 0.1
    np.testing.assert_array_equal(vector[7:], VELOCITY_POSTURE.default[7:])


def test_a_motion_moves_the_arms_as_well_and_one_of_other_arms_is_refused() -> None:
    wave = load("builtin:wave")
    reference = wave.at(wave.duration_s / 2)
    arms = [reference.q[wave.joint_names.index(name)] for name in ARMS]
    np.testing.assert_array_equal(VELOCITY_POSTURE.encode(reference, wave.joint_names)[7:], arms)
    with pytest.raises(ConfigError, match="the motion has no joint 'left_shoulder_pitch'"):
        VELOCITY_POSTURE.encode(reference, ("knee",))
