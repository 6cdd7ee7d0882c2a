"""What an operator's movement asks of a robot: differences from where both were when it began.

Poses are in frames whose axes point forward, left and up on both sides, because devices are converted by their
adapters: the matrix between the two worlds (T of ``p = p0 + T (p_now - p_start)``) is the identity here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from station import rotations
from station.operator.sample import Pose
from station.protocols import Floats

JUMP_M = 0.3
"""Between two samples of a device no hand goes farther; the tracking was lost, or centred anew [m]."""

JUMP_RAD = math.radians(45.0)
"""Nor does it turn farther [rad]."""

_UNIT_TOLERANCE = 1e-3


def followed(target: Pose, start: Pose, now: Pose, *, scale: float = 1.0, heading_rad: float = 0.0) -> Pose:
    """Return where a target goes when an operator moves from start to now.

    ``p = p0 + scale (p_now - p_start)``, ``R = (R_now R_start^-1) R0``: differences are taken along the axes of the
    operator's world, not of the hand.

    Args:
        target: Where the target was at the start.
        start, now: Where the operator was at the start, and is.
        scale: How far the target goes for each metre; rotations are not scaled.
        heading_rad: Where the operator faces in the operator's world: that forward becomes the target's.
    """
    moved = scale * (now.position - start.position)
    turned = rotations.multiply(now.quat_wxyz, rotations.inverse(start.quat_wxyz))
    if heading_rad:
        back = rotations.from_rotation_vector(np.array([0.0, 0.0, -heading_rad]))
        moved = rotations.rotate(back, moved)
        turned = rotations.multiply(rotations.multiply(back, turned), rotations.inverse(back))
    quat = rotations.normalized(rotations.multiply(turned, target.quat_wxyz))
    return Pose(target.position + moved, quat)


def why_not(pose: Pose | None) -> str:
    """Return why a pose is none, or "": not tracked, not finite, or a quaternion without length, as before data."""
    if pose is None:
        return "is not tracked"
    if not (np.isfinite(pose.position).all() and np.isfinite(pose.quat_wxyz).all()):
        return "has no number for a pose"
    if abs(float(np.linalg.norm(pose.quat_wxyz)) - 1.0) > _UNIT_TOLERANCE:
        return "has no orientation yet"
    return ""


def jump(before: Mapping[str, Pose], now: Mapping[str, Pose]) -> str:
    """Return what jumped between two samples of named poses, or ""; one that is in one of them only has jumped."""
    for name in before.keys() ^ now.keys():
        return f"{name} was lost" if name in before else f"{name} appeared"
    for name, pose in now.items():
        metres = float(np.linalg.norm(pose.position - before[name].position))
        if metres > JUMP_M:
            return f"{name} jumped {metres:.2f} m between two samples (limit {JUMP_M:g} m)"
        radians = angle_between(before[name].quat_wxyz, pose.quat_wxyz)
        if radians > JUMP_RAD:
            degrees = math.degrees(radians)
            return f"{name} turned {degrees:.0f} deg between two samples (limit {math.degrees(JUMP_RAD):.0f} deg)"
    return ""


def angle_between(start_wxyz: Floats, end_wxyz: Floats) -> float:
    """Return the angle of the shorter way from one orientation to another [rad]."""
    turn = rotations.multiply(rotations.inverse(start_wxyz), end_wxyz)
    return float(np.linalg.norm(rotations.rotation_vector(turn)))
