"""Rotations as quaternions ``w x y z``, for arrays of any leading shape (..., 4).

A rotation ``q`` takes vectors of the body frame into the world frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from station.protocols import Floats

_LEAST_NORM = 1e-150


def normalized(quat_wxyz: ArrayLike) -> Floats:
    """Return unit quaternions, shape (..., 4); NaN for four zeros, which are no rotation."""
    quat = np.asarray(quat_wxyz, dtype=np.float64)
    with np.errstate(all="ignore"):  # a damaged recording holds any number
        norm = np.linalg.norm(quat, axis=-1, keepdims=True)
        if not ((norm > _LEAST_NORM) & (norm < 1.0 / _LEAST_NORM)).all():  # squares that no float holds
            quat = quat / np.abs(quat).max(axis=-1, keepdims=True)
            norm = np.linalg.norm(quat, axis=-1, keepdims=True)
        return np.asarray(quat / norm)


def multiply(left: ArrayLike, right: ArrayLike) -> Floats:
    """Return the rotation ``right`` followed by ``left``, shape (..., 4)."""
    w, x, y, z = _parts(left)
    a, b, c, d = _parts(right)
    return joined(
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )


def inverse(quat_wxyz: ArrayLike) -> Floats:
    """Return the inverse of unit quaternions, shape (..., 4)."""
    return np.asarray(np.asarray(quat_wxyz, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0]))


def rotate(quat_wxyz: ArrayLike, vector: ArrayLike) -> Floats:
    """Rotate vectors (..., 3) from the body frame into the world frame."""
    w, x, y, z = _parts(quat_wxyz)
    a, b, c = _parts(vector)
    # v + 2 w (u x v) + 2 u x (u x v), with u the vector part: no matrix and no second product is needed.
    p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return joined(a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p)


def rotate_inverse(quat_wxyz: ArrayLike, vector: ArrayLike) -> Floats:
    """Rotate vectors (..., 3) from the world frame into the body frame."""
    return rotate(inverse(quat_wxyz), vector)


def roll_pitch_yaw(quat_wxyz: ArrayLike) -> Floats:
    """Return ZYX Euler angles roll, pitch, yaw [rad], shape (..., 3); pitch is clamped to ±pi/2."""
    w, x, y, z = _parts(quat_wxyz)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return joined(roll, pitch, yaw)


def from_roll_pitch_yaw(angles: ArrayLike) -> Floats:
    """Return the quaternion of ZYX Euler angles roll, pitch, yaw [rad], shape (..., 4)."""
    half = 0.5 * np.asarray(angles, dtype=np.float64)
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(half), -1, 0), np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
         cr * cp * sy - sr * sp * cy], axis=-1,
    )  # fmt: skip


def from_rotation_vector(vector: ArrayLike) -> Floats:
    """Return the quaternion of a rotation vector (axis times angle [rad]), shape (..., 4)."""
    vec = np.asarray(vector, dtype=np.float64)
    angle = np.linalg.norm(vec, axis=-1, keepdims=True)
    # np.sinc(t) = sin(pi t) / (pi t), smooth through zero
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * vec], axis=-1)


def rotation_vector(quat_wxyz: ArrayLike) -> Floats:
    """Return axis times angle [rad] of the shorter way round, shape (..., 3)."""
    quat = np.asarray(quat_wxyz, dtype=np.float64)
    quat = np.where(quat[..., :1] < 0, -quat, quat)
    sine = np.linalg.norm(quat[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quat[..., :1])
    scale = np.divide(angle, sine, out=np.full_like(angle, 2.0), where=sine > 1e-12)
    return np.asarray(quat[..., 1:] * scale)


def slerp(start: ArrayLike, end: ArrayLike, fraction: ArrayLike) -> Floats:
    """Return the rotation a fraction of the shorter way from start to end, shape (..., 4)."""
    step = rotation_vector(multiply(inverse(start), end))
    portion = np.asarray(fraction, dtype=np.float64)[..., None]
    return normalized(multiply(start, from_rotation_vector(step * portion)))


def tilt(quat_wxyz: ArrayLike) -> Floats:
    """Return the angle between the body's z axis and the world's [rad], shape (...)."""
    up = rotate(quat_wxyz, np.array([0.0, 0.0, 1.0]))
    return np.asarray(np.arccos(np.clip(up[..., 2], -1.0, 1.0)))


def _parts(values: ArrayLike) -> tuple[Any, ...]:
    """Return the elements along the last axis; plain floats for a single quaternion, which is five times faster."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 1:
        return tuple(array.tolist())
    return tuple(array[..., index] for index in range(array.shape[-1]))


def joined(*parts: Any) -> Floats:
    """Return arrays of the elements as one array, shape (..., number of elements)."""
    if isinstance(parts[0], float):
        return np.array(parts)
    joined = np.empty((*np.broadcast(*parts).shape, len(parts)))  # a third of the time that np.stack takes
    for index, part in enumerate(parts):
        joined[..., index] = part
    return joined
