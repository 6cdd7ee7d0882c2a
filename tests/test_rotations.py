"""Quaternion arithmetic against what it must mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from station import rotations
from station.protocols import Floats

_unit = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)
quats = _unit.map(rotations.normalized)
vectors = st.lists(st.floats(-10, 10), min_size=3, max_size=3).map(np.array)


def matrix(quat: Floats) -> Floats:
    """Rotation matrix, from its definition."""
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@given(st.lists(st.floats(), min_size=4, max_size=4))
@example([1.7e-164, 0.0, 0.0, 0.0])
@example([1e200, -1e200, 0.0, 0.0])
def test_any_four_numbers_are_made_a_unit_quaternion_or_none_at_all(numbers: list[float]) -> None:
    quat = rotations.normalized(numbers)
    if np.isfinite(numbers).all() and np.any(numbers):
        np.testing.assert_allclose(np.linalg.norm(quat), 1.0, rtol=1e-12)
        assert (np.sign(quat) * np.sign(numbers) >= 0).all()
    else:
        assert not np.isfinite(quat).all()


@given(quats, vectors)
def test_a_vector_is_rotated_as_by_the_matrix_and_back(quat: Floats, vector: Floats) -> None:
    rotated = rotations.rotate(quat, vector)
    np.testing.assert_allclose(rotated, matrix(quat) @ vector, atol=1e-12)
    np.testing.assert_allclose(rotations.rotate_inverse(quat, rotated), vector, atol=1e-12)


@given(quats, quats)
def test_a_product_is_one_rotation_after_the_other(left: Floats, right: Floats) -> None:
    np.testing.assert_allclose(matrix(rotations.multiply(left, right)), matrix(left) @ matrix(right), atol=1e-12)


@given(quats)
def test_angles_and_rotation_vectors_describe_the_same_rotation(quat: Floats) -> None:
    roll, pitch, yaw = rotations.roll_pitch_yaw(quat)
    assume(abs(pitch) < 1.5)  # at the pole roll and yaw are one angle
    turns = [rotations.from_rotation_vector(np.eye(3)[axis] * angle) for axis, angle in enumerate((roll, pitch, yaw))]
    rebuilt = rotations.multiply(turns[2], rotations.multiply(turns[1], turns[0]))
    np.testing.assert_allclose(matrix(rebuilt), matrix(quat), atol=1e-6)
    again = rotations.from_rotation_vector(rotations.rotation_vector(quat))
    np.testing.assert_allclose(matrix(again), matrix(quat), atol=1e-9)


@given(quats, quats)
def test_slerp_goes_the_shorter_way_at_constant_speed(start: Floats, end: Floats) -> None:
    angle = np.linalg.norm(rotations.rotation_vector(rotations.multiply(rotations.inverse(start), end)))
    half = rotations.slerp(start, end, 0.5)
    to_half = np.linalg.norm(rotations.rotation_vector(rotations.multiply(rotations.inverse(start), half)))
    assert to_half == pytest.approx(angle / 2, abs=1e-7)
    np.testing.assert_allclose(matrix(rotations.slerp(start, end, 1.0)), matrix(end), atol=1e-9)


@given(st.lists(st.tuples(quats, quats, vectors), min_size=1, max_size=5))
def test_many_at_once_give_what_each_gives_alone(items: list[tuple[Floats, Floats, Floats]]) -> None:
    left, right, vector = (np.array(column) for column in zip(*items, strict=True))
    for index in range(len(items)):
        single = rotations.multiply(left[index], right[index])
        np.testing.assert_allclose(rotations.multiply(left, right)[index], single, rtol=1e-15, atol=1e-15)
        alone = rotations.rotate(left[index], vector[index])
        np.testing.assert_allclose(rotations.rotate(left, vector)[index], alone, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(rotations.tilt(left)[index], rotations.tilt(left[index]), atol=1e-12)


def test_shapes_broadcast_and_tilt_is_the_angle_of_the_z_axis() -> None:
    lying = rotations.from_rotation_vector([np.pi / 2, 0.0, 0.0])
    assert rotations.tilt(lying) == pytest.approx(np.pi / 2)
    assert rotations.tilt([1.0, 0.0, 0.0, 0.0]) == 0.0
    assert rotations.multiply(lying, np.tile([1.0, 0.0, 0.0, 0.0], (3, 2, 1))).shape == (3, 2, 4)
    assert rotations.rotate(np.tile(lying, (5, 1)), [0.0, 0.0, 1.0]).shape == (5, 3)


def test_roll_pitch_and_yaw_become_the_quaternion_that_has_them() -> None:
    angles = np.random.default_rng(0).uniform(-1.5, 1.5, (50, 3))
    np.testing.assert_allclose(rotations.roll_pitch_yaw(rotations.from_roll_pitch_yaw(angles)), angles, atol=1e-12)
