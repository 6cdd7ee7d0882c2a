"""Walks from a few parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adapters.motions.builtin import WalkPlan, gait
from adapters.motions.clip import Clip
from adapters.motions.transforms import mirrored
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.errors import ConfigError, UsageError
from tests.adapters.motions import builtin_checks as check


@pytest.mark.parametrize("seed", range(12))
def test_every_velocity_up_to_the_promised_ones_can_be_walked_in_any_combination(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corner = rng.choice([-1.0, 1.0], 3) if seed % 2 else rng.uniform(-1.0, 1.0, 3)
    plan = WalkPlan(
        velocity_x=0.8 * corner[0] if corner[0] > 0 else 0.4 * corner[0],
        velocity_y=0.3 * corner[1],
        yaw_rate=0.8 * corner[2],
        duration_s=rng.uniform(2.0, 5.0),
        ramp_s=rng.uniform(0.3, 1.5),
    )
    motion = gait(plan)
    check.assert_within_ranges(motion)
    check.assert_stands_at_rest_at_both_ends(motion)
    check.assert_smooth(motion, acceleration=600.0, speed_used=0.65)
    check.assert_feet_carry(motion)


@pytest.mark.parametrize("wish", [(0.6, 0.0, 0.0), (-0.3, 0.0, 0.0), (0.0, 0.25, 0.0), (0.0, 0.0, -0.7)])
def test_a_walk_goes_as_far_as_its_velocity_says(wish: tuple[float, float, float]) -> None:
    plan = WalkPlan(velocity_x=wish[0], velocity_y=wish[1], yaw_rate=wish[2], duration_s=4.0, ramp_s=1.0)
    motion = gait(plan)
    went = [*motion.root_pos[-1, :2], rotations.roll_pitch_yaw(motion.root_quat_wxyz[-1])[2]]
    np.testing.assert_allclose(went, 3.0 * np.array(wish), atol=2e-3)


def test_plans_follow_each_other_without_a_stop() -> None:
    motion = gait(WalkPlan(velocity_x=0.5, duration_s=3.0), WalkPlan(velocity_x=0.5, yaw_rate=0.5, duration_s=3.0))
    check.assert_within_ranges(motion)
    check.assert_smooth(motion, acceleration=400.0)
    check.assert_feet_carry(motion)
    speed = np.linalg.norm(np.diff(motion.root_pos[:, :2], axis=0), axis=1) * motion.fps
    assert speed[150:250].min() > 0.3


def test_the_mirror_image_of_a_walk_to_the_left_is_the_walk_to_the_right() -> None:
    plan = WalkPlan(velocity_x=0.3, velocity_y=0.2, yaw_rate=0.3, duration_s=3.0)
    left = Clip(gait(plan))
    right = Clip(gait(replace(plan, velocity_y=-0.2, yaw_rate=-0.3)))
    for time_s in np.arange(0.0, left.duration_s, 0.1):
        image, seen = mirrored(left).at(time_s), right.at(time_s)
        np.testing.assert_allclose(image.q, seen.q, atol=2e-3)
        np.testing.assert_allclose(image.root_pos, seen.root_pos, atol=1e-3)


def test_feet_are_lifted_as_high_and_stepped_as_often_as_wished() -> None:
    motion = gait(WalkPlan(velocity_x=0.4, duration_s=5.0, clearance=0.08, step_s=0.5))
    links = kinematics.forward(motion.root_pos, motion.root_quat_wxyz, motion.q)
    left = links.position[kinematics.INDEX["left_ankle_roll"]][:, 2]
    lifted = left - left[0]
    assert lifted.max() == pytest.approx(0.08, abs=2e-3)
    lift_offs = np.flatnonzero(np.diff((lifted > 1e-3).astype(int)) == 1) / motion.fps
    np.testing.assert_allclose(np.diff(lift_offs), 1.0, atol=0.021)


def test_arms_swing_against_the_legs_unless_they_shall_not() -> None:
    plan = WalkPlan(velocity_x=0.6, duration_s=4.0)
    still, swinging = (gait(replace(plan, arm_swing=swing)) for swing in (0.0, 1.0))
    shoulder, hip = (G1_29.index(f"left_{name}_pitch") for name in ("shoulder", "hip"))
    assert np.ptp(still.q[:, shoulder]) < 1e-9
    steady = slice(100, 250)
    assert np.ptp(swinging.q[steady, shoulder]) > 0.2
    assert np.corrcoef(swinging.q[steady, shoulder], swinging.q[steady, hip])[0, 1] < -0.8


def test_marching_lifts_the_feet_and_goes_nowhere() -> None:
    motion = gait(WalkPlan(duration_s=3.0))
    assert np.abs(motion.root_pos[:, 0]).max() < 0.01
    links = kinematics.forward(motion.root_pos, motion.root_quat_wxyz, motion.q)
    for side in ("left", "right"):
        heights = links.position[kinematics.INDEX[f"{side}_ankle_roll"]][:, 2]
        assert np.count_nonzero(np.diff((heights > heights[0] + 0.01).astype(int)) == 1) >= 3


def test_the_first_foot_may_be_chosen() -> None:
    for side in ("left", "right"):
        motion = gait(WalkPlan(velocity_x=0.4, first_foot=side))
        links = kinematics.forward(motion.root_pos, motion.root_quat_wxyz, motion.q)
        lifted = {
            foot: int(np.flatnonzero(np.diff(links.position[kinematics.INDEX[f"{foot}_ankle_roll"]][:, 2]) > 1e-5)[0])
            for foot in ("left", "right")
        }
        assert min(lifted, key=lambda foot: lifted[foot]) == side


@pytest.mark.parametrize(
    ("wish", "expected"),
    [
        ({"velocity_x": 1.7}, r"velocity_x is 1\.7; expected -0\.6 to 1"),
        ({"yaw_rate": float("nan")}, "yaw_rate is nan; expected -1.2 to 1.2"),
        ({"duration_s": 0.5}, "duration_s 0.5 is shorter than ramp_s 0.8"),
    ],
)
def test_what_no_legs_can_do_is_refused(wish: dict[str, float], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        WalkPlan(**wish)


def test_a_combination_that_no_steps_can_do_is_refused_by_the_legs() -> None:
    with pytest.raises(ConfigError, match="ask for lower velocities"):
        gait(WalkPlan(velocity_x=1.0, velocity_y=0.4, yaw_rate=-1.2, height=0.6, width=0.35))
    with pytest.raises(UsageError, match="at least one WalkPlan"):
        gait()
