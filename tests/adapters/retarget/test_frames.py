"""The change of frame keeps handedness, lengths and the sense of every turn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.retarget import frames
from station import rotations
from station.protocols import Floats

RIGHT, UP, BACK = np.eye(3)
FORWARD, LEFT, ABOVE = np.eye(3)
Vector = tuple[float, float, float]
vectors = st.tuples(*[st.floats(-10.0, 10.0)] * 3)
rotation_vectors = st.tuples(*[st.floats(-1.8, 1.8)] * 3)


def matrix(quat_wxyz: Floats) -> Floats:
    return np.stack([rotations.rotate(quat_wxyz, axis) for axis in np.eye(3)], axis=-1)


def turn(axis: Floats, angle: float) -> Floats:
    return rotations.from_rotation_vector(axis * angle)


def test_the_matrix_is_a_proper_rotation() -> None:
    assert np.linalg.det(frames.T) == pytest.approx(1.0)
    assert np.array_equal(frames.T @ frames.T.T, np.eye(3))


@pytest.mark.parametrize(
    ("theirs", "ours"), [(-BACK, FORWARD), (-RIGHT, LEFT), (UP, ABOVE)], ids=["a step forward", "left", "up"]
)
def test_directions_stay_what_they_are(theirs: Floats, ours: Floats) -> None:
    assert np.array_equal(frames.positions_to_flu(theirs), ours)


@pytest.mark.parametrize(
    ("their_axis", "our_axis"),
    [(UP, ABOVE), (-RIGHT, LEFT), (-BACK, FORWARD)],
    ids=["turn left", "bow", "lean to the right"],
)
def test_turns_keep_their_axis_and_their_sense(their_axis: Floats, our_axis: Floats) -> None:
    turned = frames.quats_to_flu(turn(their_axis, 0.5))
    assert rotations.rotation_vector(turned) == pytest.approx(our_axis * 0.5)


def test_turning_left_makes_yaw_grow() -> None:
    """30° to the left about up, seen as what it does: what pointed forward points forward and left."""
    turned = frames.quats_to_flu(turn(UP, np.radians(30.0)))
    assert rotations.roll_pitch_yaw(turned) == pytest.approx([0.0, 0.0, np.radians(30.0)])
    assert rotations.rotate(turned, FORWARD) == pytest.approx([np.sqrt(0.75), 0.5, 0.0])


@given(rotation_vectors)
def test_a_proper_rotation_stays_proper(vector: Vector) -> None:
    converted = frames.rotations_to_flu(matrix(rotations.from_rotation_vector(vector)))
    assert np.linalg.det(converted) == pytest.approx(1.0)
    assert converted @ converted.T == pytest.approx(np.eye(3), abs=1e-12)


@given(rotation_vectors)
def test_the_shortcut_for_quaternions_equals_the_matrices(vector: Vector) -> None:
    quat = rotations.from_rotation_vector(vector)
    assert matrix(frames.quats_to_flu(quat)) == pytest.approx(frames.rotations_to_flu(matrix(quat)), abs=1e-12)


@given(rotation_vectors, vectors)
def test_positions_and_orientations_turn_together(vector: Vector, point: Vector) -> None:
    """A point that a rotation carries along lands in the same place, whichever is converted first."""
    quat = rotations.from_rotation_vector(vector)
    converted_last = frames.positions_to_flu(rotations.rotate(quat, point))
    converted_first = rotations.rotate(frames.quats_to_flu(quat), frames.positions_to_flu(point))
    assert converted_first == pytest.approx(converted_last, abs=1e-9)


@given(rotation_vectors, rotation_vectors)
def test_the_turn_between_two_instants_is_that_of_the_converted_ones(start: Vector, now: Vector) -> None:
    first, second = rotations.from_rotation_vector(start), rotations.from_rotation_vector(now)
    between = rotations.multiply(second, rotations.inverse(first))
    converted = rotations.multiply(frames.quats_to_flu(second), rotations.inverse(frames.quats_to_flu(first)))
    assert converted == pytest.approx(frames.quats_to_flu(between), abs=1e-12)


@given(st.lists(vectors, min_size=1, max_size=24))
def test_whole_skeletons_convert_as_their_joints_do_and_back(points: list[Vector]) -> None:
    converted = frames.positions_to_flu(points)
    assert converted == pytest.approx(np.stack([frames.positions_to_flu(point) for point in points]))
    assert frames.positions_from_flu(converted) == pytest.approx(np.array(points))
    distances = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    assert np.linalg.norm(np.diff(converted, axis=0), axis=-1) == pytest.approx(distances)


def test_the_order_of_quaternions_on_the_wire_is_the_other_one() -> None:
    assert frames.wxyz([1.0, 2.0, 3.0, 4.0]).tolist() == [4.0, 1.0, 2.0, 3.0]
    assert frames.xyzw([4.0, 1.0, 2.0, 3.0]).tolist() == [1.0, 2.0, 3.0, 4.0]
    assert frames.quats_from_flu(frames.quats_to_flu([[0.1, 0.2, 0.3, 0.4]])).tolist() == [[0.1, 0.2, 0.3, 0.4]]
