"""Rotation matrices of bones: made of two directions, turned into quaternions."""

from __future__ import annotations

import numpy as np

from station.protocols import Floats

_LEAST = 1e-9  # m; a direction of a shorter vector is noise


def directed(vectors: Floats) -> Floats:
    """Return vectors of unit length, shape (..., 3); those of no length point along x, so nothing becomes NaN."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > _LEAST, vectors / np.maximum(length, _LEAST), np.array([1.0, 0.0, 0.0]))


def along_y(y: Floats, z: Floats) -> Floats:
    """Return right-handed frames whose y is exact and whose z is as near as it can be, shape (..., 3, 3)."""
    y = directed(y)
    x = directed(np.cross(y, z))
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def along_z(z: Floats, x: Floats) -> Floats:
    """Return right-handed frames whose z is exact and whose x is as near as it can be, shape (..., 3, 3)."""
    z = directed(z)
    y = directed(np.cross(z, x))
    return np.stack([np.cross(y, z), y, z], axis=-1)


def to_quats(matrices: Floats) -> Floats:
    """Return unit quaternions ``w x y z`` of rotation matrices, shape (..., 4)."""
    m = matrices
    # Four ways to the same quaternion, each times one of its elements; the one of the greatest element is accurate.
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    x, y, z = (1.0 + 2.0 * m[..., axis, axis] - trace for axis in range(3))
    rows = np.stack(
        [np.stack(row, axis=-1) for row in ((1.0 + trace, a, b, c), (a, x, d, e), (b, d, y, f), (c, e, f, z))], axis=-2
    )
    best = np.argmax(np.stack([1.0 + trace, x, y, z], axis=-1), axis=-1)
    quats = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(quats / np.linalg.norm(quats, axis=-1, keepdims=True))
