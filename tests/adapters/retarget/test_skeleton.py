"""The person who does what a G1 does."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.motions.load import load
from adapters.retarget.bone_frames import to_quats
from adapters.retarget.human import G1_SIZED, INDEX, of_height, standing
from adapters.retarget.skeleton import skeleton_of
from adapters.robots.g1 import kinematics
from station import rotations
from tests.adapters.retarget.people import bone_lengths, doing


@pytest.mark.parametrize("height_m", [1.5, 1.7, 1.9])
def test_a_person_of_a_height_is_that_tall(height_m: float) -> None:
    assert of_height(height_m).height == pytest.approx(height_m, abs=1e-3)
    head = standing(of_height(height_m)).positions[INDEX["head"], 2]
    assert 0.9 * height_m < head < 0.96 * height_m


@pytest.mark.parametrize("clip", ["walk-fast", "squat", "wave", "turn-left", "sway"])
@pytest.mark.parametrize("height_m", [None, 1.5, 1.9])
def test_bones_keep_their_lengths(clip: str, height_m: float | None) -> None:
    lengths = bone_lengths(doing(clip, height_m).positions)
    assert np.ptp(lengths[:, [row for row in range(23) if row not in _COLLARS]], axis=0).max() < 2e-3


_COLLARS = [INDEX[name] - 1 for name in ("left_collar", "right_collar", "left_shoulder", "right_shoulder")]
"""Hang on the chest, which is seen from the neck; the spine bends between."""


@pytest.mark.parametrize("clip", ["walk-forward", "turn-left", "walk-diagonal"])
def test_a_foot_that_the_robot_holds_still_is_held_still(clip: str) -> None:
    motion, person = load(f"builtin:{clip}"), doing(clip, 1.8)
    links = kinematics.forward(
        *(
            np.array([getattr(motion.at(time_s), name) for time_s in person.times_s.tolist()])
            for name in ("root_pos", "root_quat_wxyz", "q")
        )
    )
    for side in ("left", "right"):
        robot = np.linalg.norm(np.diff(links.position[kinematics.INDEX[f"{side}_ankle_roll"]], axis=0), axis=1)
        human = np.linalg.norm(np.diff(person.positions[:, INDEX[f"{side}_ankle"]], axis=0), axis=1)
        assert (robot < 1e-5).mean() > 0.3
        assert human[robot < 1e-5].max() < 1e-4


def test_the_rest_frames_of_a_t_pose_are_the_worlds() -> None:
    body = standing(of_height(1.7), arms="out")
    np.testing.assert_allclose(body.quats_wxyz, np.tile([1.0, 0.0, 0.0, 0.0], (24, 1)), atol=1e-12)
    turned = standing(of_height(1.7), heading_rad=1.0)
    np.testing.assert_allclose(rotations.roll_pitch_yaw(turned.quats_wxyz)[:, 2], 1.0, atol=1e-12)


def test_hanging_arms_hang_with_palms_to_the_thighs() -> None:
    body = standing(of_height(1.7), arms="down")
    for side, inward in (("left", -1.0), ("right", 1.0)):
        arm = body.positions[INDEX[f"{side}_wrist"]] - body.positions[INDEX[f"{side}_shoulder"]]
        assert arm[2] < -0.4
        palm = rotations.rotate(body.quats_wxyz[INDEX[f"{side}_wrist"]], np.array([0.0, 0.0, -1.0]))
        np.testing.assert_allclose(palm, [0.0, inward, 0.0], atol=1e-12)


def test_palms_are_inward_and_thumbs_forward_on_both_sides() -> None:
    """A standing G1 lets its forearms hang a little forward; the person does likewise."""
    body = skeleton_of(load("builtin:stand").at(0.0))
    for side, inward in (("left", -1.0), ("right", 1.0)):
        quat = body.quats_wxyz[INDEX[f"{side}_wrist"]]
        thumb, palm = (rotations.rotate(quat, np.array(axis)) for axis in ([1.0, 0.0, 0.0], [0.0, 0.0, -1.0]))
        assert thumb[0] > 0.9
        assert inward * palm[1] > 0.9


@pytest.mark.parametrize("height_m", [1.5, 1.9])
def test_who_stands_has_the_feet_below_the_own_hips(height_m: float) -> None:
    body = skeleton_of(load("builtin:stand").at(0.0), height_m)
    for side in ("left", "right"):
        foot, hip = (body.positions[INDEX[f"{side}_{joint}"], 1] for joint in ("ankle", "hip"))
        assert foot == pytest.approx(hip, abs=0.005)


def test_a_reference_and_its_qpos_are_the_same_person() -> None:
    reference = load("builtin:wave").at(2.0)
    qpos = np.concatenate([reference.root_pos, reference.root_quat_wxyz, reference.q])
    np.testing.assert_array_equal(
        skeleton_of(reference, 1.8).positions, skeleton_of(qpos, lengths=of_height(1.8)).positions
    )


def test_a_person_as_large_as_the_robot_has_its_feet_and_pelvis_where_they_are() -> None:
    reference = load("builtin:walk-forward").at(3.0)
    links = kinematics.forward(reference.root_pos[None], reference.root_quat_wxyz[None], reference.q[None])
    body = skeleton_of(reference)
    np.testing.assert_allclose(body.positions[INDEX["pelvis"]], reference.root_pos, atol=1e-9)
    for side in ("left", "right"):
        ankle = links.position[kinematics.INDEX[f"{side}_ankle_roll"], 0]
        np.testing.assert_allclose(body.positions[INDEX[f"{side}_ankle"]], ankle, atol=1e-9)
        knee = links.position[kinematics.INDEX[f"{side}_knee"], 0]
        np.testing.assert_allclose(body.positions[INDEX[f"{side}_knee"]], knee, atol=0.02)
    assert G1_SIZED.height == pytest.approx(1.33, abs=0.02)


def test_quaternions_of_matrices_are_those_they_came_from() -> None:
    quats = rotations.normalized(np.random.default_rng(0).normal(size=(500, 4)))
    quats[:3] = np.eye(4)[1:]  # half turns, where the usual formula divides by zero
    matrices = np.stack([rotations.rotate(quats, axis) for axis in np.eye(3)], axis=-1)
    same = np.abs((to_quats(matrices) * quats).sum(axis=-1))
    np.testing.assert_allclose(same, 1.0, atol=1e-12)
