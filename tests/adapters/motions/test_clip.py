from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.motions.clip import Clip
from adapters.motions.raw import RawMotion
from station import rotations
from station.protocols import Motion
from tests.adapters.motions.made import smooth

WALK = smooth()
CLIP = Clip(WALK)


def test_a_clip_is_a_motion() -> None:
    motion: Motion = CLIP
    assert motion.name == "walk"
    assert motion.duration_s == pytest.approx(89 / 30)
    assert len(motion.joint_names) == 29


def test_at_a_recorded_frame_the_reference_is_that_frame() -> None:
    for frame in (0, 1, 50, 89):
        reference = CLIP.at(frame / WALK.fps)
        np.testing.assert_allclose(reference.root_pos, WALK.root_pos[frame], atol=1e-9)
        np.testing.assert_allclose(reference.q, WALK.q[frame], atol=1e-9)
        np.testing.assert_allclose(reference.root_quat_wxyz, WALK.root_quat_wxyz[frame], atol=1e-9)


def test_between_frames_positions_are_linear_and_rotations_slerp() -> None:
    reference = CLIP.at(10.25 / WALK.fps)
    np.testing.assert_allclose(reference.q, 0.75 * WALK.q[10] + 0.25 * WALK.q[11], atol=1e-12)
    expected = rotations.slerp(WALK.root_quat_wxyz[10], WALK.root_quat_wxyz[11], 0.25)
    np.testing.assert_allclose(reference.root_quat_wxyz, expected, atol=1e-12)


def test_velocities_are_those_of_the_walk_in_the_root_frame() -> None:
    for time_s in (0.5, 1.234, 2.5):
        reference = CLIP.at(time_s)
        np.testing.assert_allclose(reference.root_lin_vel[:2], [0.6, 0.0], atol=0.002)
        assert reference.root_lin_vel[2] == pytest.approx(0.12 * np.cos(6 * time_s), abs=0.003)
        np.testing.assert_allclose(reference.root_ang_vel, [0, 0, 0.5], atol=1e-9)


def test_angular_velocity_is_in_the_root_frame_also_when_the_root_is_tilted() -> None:
    tilt = rotations.from_rotation_vector([0.0, 0.7, 0.0])
    spin = rotations.from_rotation_vector(np.outer(np.arange(30) / 30.0, [0.0, 0.0, 1.5]))
    quats = rotations.multiply(tilt, spin)  # turns about its own z axis
    clip = Clip(RawMotion(WALK.path, "npz", 30.0, np.zeros((30, 3)), quats, np.zeros((30, 29))))
    np.testing.assert_allclose(clip.at(0.5).root_ang_vel, [0, 0, 1.5], atol=1e-9)


@given(st.floats(allow_nan=False))
def test_any_time_is_clamped_into_the_motion(time_s: float) -> None:
    reference = CLIP.at(time_s)
    clamped = CLIP.at(min(max(time_s, 0.0), CLIP.duration_s))
    np.testing.assert_array_equal(reference.q, clamped.q)
    assert np.linalg.norm(reference.root_quat_wxyz) == pytest.approx(1.0)


def test_signs_of_quaternions_do_not_matter() -> None:
    signs = np.where(np.arange(len(WALK)) % 2, -1.0, 1.0)[:, None]
    flipped = Clip(RawMotion(WALK.path, "npz", 30.0, WALK.root_pos, WALK.root_quat_wxyz * signs, WALK.q))
    for time_s in (0.0, 0.51, 2.0):
        np.testing.assert_allclose(flipped.at(time_s).root_ang_vel, CLIP.at(time_s).root_ang_vel, atol=1e-9)


def test_a_rate_that_is_not_whole_keeps_the_duration() -> None:
    odd = Clip(smooth(frames=299, fps=29.876))
    assert odd.duration_s == pytest.approx(298 / 29.876)
    np.testing.assert_allclose(odd.at(odd.duration_s).root_pos, smooth(299, 29.876).root_pos[-1])


def test_what_is_returned_may_be_changed_without_changing_the_clip() -> None:
    before = CLIP.at(0.0).q.copy()
    CLIP.at(0.0).q[:] = 99.0
    np.testing.assert_array_equal(CLIP.at(0.0).q, before)
