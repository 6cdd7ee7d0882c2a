"""Orientations of body parts from joint positions, where a file has none: (n, 3, 3), columns forward, left, up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adapters.retarget.bone_frames import along_y, along_z, directed
from station.protocols import Floats

_FLAT = 0.2

Y_TO_Z_UP = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""From a world with x left, y up, z forward to ours: x forward, y left, z up."""


def axis_up(head: Floats, ankles: Floats) -> Floats:
    """Return which axis of a world is up, a unit vector of shape (3,): the one along which heads are above ankles."""
    towards = (head - ankles).mean(axis=0)
    axis = int(np.abs(towards).argmax())
    return np.asarray(np.where(np.arange(3) == axis, np.sign(towards), 0.0))


def lowest(heights: Floats) -> NDArray[np.bool_]:
    """Return the frames in which a foot is as low as in a fifth of them: it stands flat, or nearly so."""
    return np.asarray(heights <= np.quantile(heights, _FLAT))


def upright(up: Floats, left: Floats) -> Floats:
    """Return frames whose up is exact and whose left is as near as it can be, from directions of shape (n, 3)."""
    return along_z(up, np.cross(left, up))


def level_foot(ankle: Floats, ball: Floats, up: Floats) -> Floats:
    """Return frames of feet that stand flat: level, and forward as the ball is from the ankle; `up` of shape (3,)."""
    return along_z(np.broadcast_to(up, ankle.shape), ball - ankle)


def arm(sign: float, towards: Floats, back: Floats) -> Floats:
    """Return frames of a part of an arm: `sign` 1 for the left one, which points to its left; `back` is its up."""
    return along_y(sign * towards, back)


def turn_between(first: Floats, second: Floats) -> Floats:
    """Return the smallest rotation that takes a direction to another, shape (3, 3)."""
    first, second = directed(first), directed(second)
    cosine, axis = float(first @ second), np.cross(first, second)
    if cosine < -1.0 + 1e-9:  # any axis at a right angle will do
        side = directed(np.cross(first, np.eye(3)[int(np.abs(first).argmin())]))
        return np.asarray(2.0 * np.outer(side, side) - np.eye(3))
    cross = np.cross(np.eye(3), axis)  # the matrix of the cross product
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))


def fitted(turns: Floats, frames: Floats) -> Floats:
    """Return the rotation C, shape (3, 3), with which ``turns @ C`` come nearest to `frames`, both (n, 3, 3)."""
    left, _, right = np.linalg.svd((turns.swapaxes(-1, -2) @ frames).sum(axis=0))
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)
