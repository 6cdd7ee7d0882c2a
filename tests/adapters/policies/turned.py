"""Rotations by their definition, beside which policies' arithmetic is held."""

from __future__ import annotations

import numpy as np

from station.protocols import Floats
from station.rotations import roll_pitch_yaw


def turned(axis: int, angle: float) -> Floats:
    """Return the matrix that turns about an axis, 0 to 2."""
    made = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    made[first, first] = made[second, second] = np.cos(angle)
    made[first, second], made[second, first] = -np.sin(angle), np.sin(angle)
    return made


def of_root(quat_wxyz: Floats) -> Floats:
    """Return the matrix of a quaternion."""
    roll, pitch, yaw = roll_pitch_yaw(quat_wxyz)
    return turned(2, yaw) @ turned(1, pitch) @ turned(0, roll)


def looks(rotation: Floats) -> float:
    """Return the heading of a matrix."""
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))
