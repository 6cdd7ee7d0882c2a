"""Differences from a snapshot: exactly where the target was at first, the same movement afterwards."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station import rotations
from station.operator.deltas import angle_between, followed, jump, why_not
from station.operator.sample import Pose

EVEN = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


@st.composite
def any_pose(draw: st.DrawFn) -> Pose:
    position = np.array(draw(st.tuples(*[st.floats(-3.0, 3.0)] * 3)))
    turn = np.array(draw(st.tuples(*[st.floats(-3.0, 3.0)] * 3)))
    return Pose(position, rotations.from_rotation_vector(turn))


@settings(max_examples=50, deadline=None)
@given(any_pose(), any_pose())
def test_the_target_stays_where_it_is_until_the_operator_moves(target: Pose, start: Pose) -> None:
    found = followed(target, start, start)
    assert np.abs(found.position - target.position).max() <= 1e-12
    assert angle_between(found.quat_wxyz, target.quat_wxyz) <= 1e-6


@settings(max_examples=50, deadline=None)
@given(any_pose(), any_pose(), any_pose())
def test_the_target_moves_and_turns_as_the_operator_does(target: Pose, start: Pose, now: Pose) -> None:
    found = followed(target, start, now)
    assert found.position - target.position == pytest.approx(now.position - start.position, abs=1e-9)
    asked = rotations.multiply(now.quat_wxyz, rotations.inverse(start.quat_wxyz))
    done = rotations.multiply(found.quat_wxyz, rotations.inverse(target.quat_wxyz))
    assert angle_between(asked, done) == pytest.approx(0.0, abs=1e-6)
    assert np.linalg.norm(found.quat_wxyz) == pytest.approx(1.0)


@settings(max_examples=50, deadline=None)
@given(any_pose(), any_pose(), any_pose(), any_pose())
def test_engaging_again_on_the_way_goes_on_as_if_nothing_had_happened(
    target: Pose, start: Pose, between: Pose, end: Pose
) -> None:
    there = followed(followed(target, start, between), between, end)
    at_once = followed(target, start, end)
    assert there.position == pytest.approx(at_once.position, abs=1e-9)
    assert angle_between(there.quat_wxyz, at_once.quat_wxyz) == pytest.approx(0.0, abs=1e-6)


def test_turning_left_turns_left_and_raising_raises() -> None:
    left = rotations.from_rotation_vector([0.0, 0.0, 0.4])
    found = followed(EVEN, EVEN, Pose(np.array([0.0, 0.0, 0.2]), left))
    assert rotations.roll_pitch_yaw(found.quat_wxyz)[2] == pytest.approx(0.4)
    assert found.position == pytest.approx([0.0, 0.0, 0.2])


def test_a_scale_shortens_ways_and_leaves_turns() -> None:
    turn = rotations.from_rotation_vector([0.3, 0.0, 0.0])
    found = followed(EVEN, EVEN, Pose(np.array([1.0, 0.0, 0.0]), turn), scale=0.5)
    assert found.position == pytest.approx([0.5, 0.0, 0.0])
    assert angle_between(found.quat_wxyz, turn) == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(any_pose(), any_pose(), any_pose(), st.floats(-3.0, 3.0))
def test_an_operator_who_faces_elsewhere_moves_the_target_as_one_who_does_not(
    target: Pose, start: Pose, now: Pose, heading: float
) -> None:
    about = rotations.from_rotation_vector([0.0, 0.0, heading])

    def turned(pose: Pose) -> Pose:
        return Pose(rotations.rotate(about, pose.position), rotations.multiply(about, pose.quat_wxyz))

    found = followed(target, turned(start), turned(now), heading_rad=heading)
    plain = followed(target, start, now)
    assert found.position == pytest.approx(plain.position, abs=1e-9)
    assert angle_between(found.quat_wxyz, plain.quat_wxyz) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        (None, "is not tracked"),
        (Pose(np.zeros(3), np.zeros(4)), "has no orientation yet"),
        (Pose(np.array([0.0, math.nan, 0.0]), EVEN.quat_wxyz), "has no number for a pose"),
        (EVEN, ""),
    ],
)
def test_a_pose_without_data_is_none(pose: Pose | None, expected: str) -> None:
    assert why_not(pose) == expected


def raised_by(metres: float) -> Pose:
    return Pose(np.array([0.0, 0.0, metres]), EVEN.quat_wxyz)


def turned_by(degrees: float) -> Pose:
    return Pose(np.zeros(3), rotations.from_rotation_vector([0.0, math.radians(degrees), 0.0]))


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        ({"left": raised_by(0.29)}, ""),
        ({"left": raised_by(0.5)}, "left jumped 0.50 m between two samples (limit 0.3 m)"),
        ({"left": turned_by(44.0)}, ""),
        ({"left": turned_by(60.0)}, "left turned 60 deg between two samples (limit 45 deg)"),
        ({}, "left was lost"),
        ({"left": EVEN, "right": EVEN}, "right appeared"),
    ],
)  # fmt: skip
def test_only_the_tracking_moves_so_far_between_two_samples(now: dict[str, Pose], expected: str) -> None:
    assert jump({"left": EVEN}, now) == expected
