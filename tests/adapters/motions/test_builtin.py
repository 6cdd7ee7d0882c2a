"""Motions without a file."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.motions import builtin
from adapters.motions.load import load
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.errors import UnknownName
from tests.adapters.motions import builtin_checks as check

NAMES = (
    "stand", "wave", "reach-left", "reach-right", "reach-both", "squat", "look-around", "sway", "bow", "march",
    "walk-forward", "walk-back", "walk-left", "walk-right", "turn-left", "turn-right",
    "walk-arc", "walk-fast", "walk-diagonal", "tour",
)  # fmt: skip
ON_THE_SPOT = NAMES[:9]


def test_the_names_are_known_in_an_order_to_show_them_in() -> None:
    assert builtin.names() == NAMES
    assert set(builtin.HELD_BACK) < set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_clip_can_be_done_by_a_g1(name: str) -> None:
    motion = builtin.make(f"builtin:{name}")
    check.assert_within_ranges(motion)
    check.assert_stands_at_rest_at_both_ends(motion)
    check.assert_smooth(motion, acceleration=30.0 if name in ON_THE_SPOT else 400.0)
    check.assert_feet_carry(motion)


@pytest.mark.parametrize("name", NAMES)
def test_every_clip_loads_like_a_file_and_stays_within_the_command(name: str) -> None:
    clip = load(f"builtin:{name}")
    facts = clip.facts()
    assert facts["file"] == f"builtin:{name}"
    assert len(facts["sha256"]) == 64
    assert (facts["bad_frames"], facts["beyond_range"]) == ([], [])
    assert (clip.fps, clip.duration_s) == (50.0, facts["duration_s"])
    assert 3.0 <= clip.duration_s <= 60.0
    vectors = np.array([FORMAT.encode(clip.at(t), clip.joint_names) for t in np.arange(0.0, clip.duration_s, 0.02)])
    assert ((vectors >= FORMAT.lower) & (vectors <= FORMAT.upper)).all()


@pytest.mark.parametrize("name", ON_THE_SPOT)
def test_the_weight_stays_over_feet_that_stay(name: str) -> None:
    motion = builtin.make(f"builtin:{name}")
    links = kinematics.forward(motion.root_pos, motion.root_quat_wxyz, motion.q)
    com = links.centre_of_mass()[:, :2]
    soles = np.concatenate(
        [links.points(f"{side}_ankle_roll", kinematics.SOLE_POINTS) for side in ("left", "right")], axis=1
    )[..., :2]
    assert np.ptp(soles, axis=0).max() < 1e-4
    inside = np.minimum(com - soles.min(axis=1), soles.max(axis=1) - com)
    assert inside.min() > 0.04


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("stand", (0.0, 0.0, 0.0)),
        ("march", (0.0, 0.0, 0.0)),
        ("walk-forward", (2.6, 0.0, 0.0)),
        ("walk-back", (-1.56, 0.0, 0.0)),
        ("walk-left", (0.0, 1.04, 0.0)),
        ("walk-right", (0.0, -1.04, 0.0)),
        ("turn-left", (0.0, 0.0, np.pi / 2)),
        ("turn-right", (0.0, 0.0, -np.pi / 2)),
    ],
)
def test_a_walk_ends_where_its_name_says(name: str, end: tuple[float, float, float]) -> None:
    motion = builtin.make(f"builtin:{name}")
    yaw = rotations.roll_pitch_yaw(motion.root_quat_wxyz[-1])[2]
    np.testing.assert_allclose([*motion.root_pos[-1, :2], yaw], end, atol=2e-3)


def test_the_squat_goes_down_to_half_a_metre() -> None:
    heights = builtin.make("builtin:squat").root_pos[:, 2]
    assert 0.5 <= heights.min() <= 0.55


def test_arms_do_what_the_names_say() -> None:
    def hand(name: str, side: str) -> np.ndarray:
        motion = builtin.make(f"builtin:{name}")
        links = kinematics.forward(motion.root_pos, motion.root_quat_wxyz, motion.q)
        return links.position[kinematics.INDEX[f"{side}_wrist_yaw"]]

    hanging = hand("stand", "left")[0]
    for name, sides in (("reach-left", {"left"}), ("reach-right", {"right"}), ("reach-both", {"left", "right"})):
        for side in ("left", "right"):
            forward = hand(name, side)[:, 0].max() - hanging[0]
            assert forward > 0.12 if side in sides else forward < 0.03
    wave = hand("wave", "right")
    assert wave[:, 2].max() > 1.2
    moving_out = np.diff(wave[wave[:, 2] > 1.1][:, 1])
    assert np.count_nonzero(np.diff(np.sign(moving_out[np.abs(moving_out) > 1e-3]))) >= 5
    assert np.ptp(hand("wave", "left"), axis=0).max() < 0.03


def test_looking_around_turns_the_waist_to_both_sides() -> None:
    yaw = builtin.make("builtin:look-around").q[:, G1_29.index("waist_yaw")]
    assert (yaw.min(), yaw.max()) == pytest.approx((-0.8, 0.8), abs=1e-6)


def test_the_tour_shows_clip_after_clip_without_a_gap_and_says_when() -> None:
    tour = load("builtin:tour")
    shown = tour.facts()["clips"]
    assert [part["name"] for part in shown][:5] == ["stand", "wave", "reach-both", "squat", "walk-forward"]
    assert 40.0 <= tour.duration_s <= 60.0
    assert (shown[0]["start_s"], shown[-1]["end_s"]) == pytest.approx((0.0, tour.duration_s))
    for before, after in pairwise(shown):
        assert before["end_s"] == after["start_s"]
        np.testing.assert_allclose(tour.at(after["start_s"]).q, check.STANDING_Q, atol=1e-5)
    wave = load("builtin:wave")
    np.testing.assert_allclose(tour.at(shown[1]["start_s"] + 2.5).q, wave.at(2.5).q, atol=1e-9)
    assert "clips" not in wave.facts()


def test_a_motion_is_made_once_and_cannot_be_spoiled_by_who_gets_it() -> None:
    motion = builtin.make("builtin:squat")
    assert builtin.make("builtin:squat") is motion
    with pytest.raises(ValueError, match="read-only"):
        motion.q[0] = 0.0


def test_an_unknown_one_says_which_there_are() -> None:
    with pytest.raises(UnknownName, match=r"unknown built-in motion 'wav' \(did you mean 'wave'\?\); known: bow, "):
        load("builtin:wav")
