"""Motions on the spot, and one after the other."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.motions.builtin import Posture, WalkPlan, gait, join, postures
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.errors import ConfigError, UnknownName, UsageError
from tests.adapters.motions import builtin_checks as check


def test_a_posture_is_reached_held_and_left() -> None:
    motion = postures(Posture(move_s=1.0, hold_s=0.5, height=0.6, pitch=0.2, joints={"left_elbow": 0.3}))
    held = slice(75, 100)  # half a second of standing, a second on the way
    np.testing.assert_allclose(motion.root_pos[held, 2], 0.6, atol=1e-9)
    np.testing.assert_allclose(motion.q[held, G1_29.index("left_elbow")], 0.3, atol=1e-9)
    np.testing.assert_allclose(rotations.roll_pitch_yaw(motion.root_quat_wxyz[80]), [0.0, 0.2, 0.0], atol=1e-9)
    assert len(motion) == 176
    check.assert_stands_at_rest_at_both_ends(motion)
    check.assert_feet_carry(motion)


def test_the_weight_goes_where_it_shall() -> None:
    motion = postures(Posture(move_s=1.0, hold_s=0.2, shift_x=0.02, shift_y=0.06))
    com = kinematics.forward(motion.root_pos, motion.root_quat_wxyz, motion.q).centre_of_mass()
    np.testing.assert_allclose(com[80, :2] - com[0, :2], [0.02, 0.06], atol=4e-4)
    check.assert_feet_carry(motion)


@pytest.mark.parametrize("height", [0.45, 0.5, 0.6, 0.7])
def test_deep_squats_can_be_asked_for(height: float) -> None:
    motion = postures(Posture(move_s=1.5, height=height, pitch=0.3))
    check.assert_within_ranges(motion)
    check.assert_feet_carry(motion)


@pytest.mark.parametrize(
    ("posture", "error", "expected"),
    [
        ({"height": 0.85}, ConfigError, "foot is out of the leg's reach"),
        ({"height": 0.45, "pitch": -0.2}, ConfigError, "comes too near to an end of its range"),
        ({"joints": {"left_elbow": 2.09}}, ConfigError, "left_elbow comes too near to an end of its range"),
        ({"joints": {"left_elbwo": 0.0}}, UnknownName, r"did you mean 'left_elbow'\?"),
        ({"move_s": 0.0}, ConfigError, "move_s 0.0 and hold_s 0.0; expected at least 0.1 and 0 s"),
    ],
)
def test_what_cannot_be_is_refused(posture: dict[str, object], error: type[Exception], expected: str) -> None:
    with pytest.raises(error, match=expected):
        postures(Posture(**posture))  # type: ignore[arg-type]


def test_nothing_to_do_is_a_mistake() -> None:
    with pytest.raises(UsageError, match="at least one Posture"):
        postures()
    with pytest.raises(UsageError, match="at least one motion"):
        join()


def test_joined_motions_go_on_where_the_one_before_stood_still() -> None:
    turn = gait(WalkPlan(yaw_rate=0.5, duration_s=np.pi + 0.8))
    walk = gait(WalkPlan(velocity_x=0.5, duration_s=3.0))
    both = join(turn, walk, name="both")
    assert len(both) == len(turn) + len(walk) - 1
    assert both.path.name == "both"
    np.testing.assert_allclose(both.root_pos[-1, :2], [0.0, walk.root_pos[-1, 0]], atol=2e-3)
    check.assert_smooth(both, acceleration=400.0)
    check.assert_feet_carry(both)
