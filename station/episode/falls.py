"""Falls: those that a server reported, and those that the recorded pose shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from station import rotations
from station.episode.quality import FallSeen
from station.protocols import Floats

FALL_TILT_RAD = math.radians(60.0)
"""A torso that leans more than this has fallen; the same limit as in the robot's own server."""
UPRIGHT_RAD = math.radians(45.0)
SAME_FALL_S = 3.0  # a touch of the ground is reported at once, the tilt follows within a second or two

_WAIST = (("waist_yaw", (0.0, 0.0, 1.0)), ("waist_roll", (1.0, 0.0, 0.0)), ("waist_pitch", (0.0, 1.0, 0.0)))


def torso_tilt(root_quat_wxyz: Floats, names: Sequence[str], values: Floats) -> Floats:
    """Return the angle between the torso's up and the world's [rad], shape (n,).

    Args:
        root_quat_wxyz: Orientation of the pelvis, shape (n, 4).
        names: Names of m elements; ``waist_yaw_pos`` and its two siblings are looked for, absent ones count as zero.
        values: Their values, shape (n, m) [rad].
    """
    torso = rotations.normalized(root_quat_wxyz)
    for joint, axis in _WAIST:  # the chain of a G1 from the pelvis up
        if f"{joint}_pos" in names:
            angle = values[:, list(names).index(f"{joint}_pos")]
            torso = rotations.multiply(torso, rotations.from_rotation_vector(angle[:, None] * np.array(axis)))
    return rotations.tilt(torso)


def from_pose(robot: str, times_s: Floats, tilt_rad: Floats) -> list[FallSeen]:
    """Return each time the tilt went beyond the limit; a next one counts only after the torso was upright again.

    Args:
        robot: Suffix of the robot.
        times_s, tilt_rad: Time from the start of the episode, and tilt of the torso, shape (n,).
    """
    found: list[FallSeen] = []
    is_down = False
    for time_s, tilt in zip(times_s, tilt_rad, strict=True):
        if not is_down and tilt > FALL_TILT_RAD:
            found.append(FallSeen(at_s=float(time_s), robot=robot, tilt_rad=float(tilt), seen_by="pose"))
        is_down = bool(tilt > FALL_TILT_RAD or (is_down and tilt > UPRIGHT_RAD))
    return found


def merged(reported: list[FallSeen], derived: list[FallSeen]) -> list[FallSeen]:
    """Return every fall once: a derived one near a reported one is the same fall."""
    extra = [fall for fall in derived if all(abs(fall.at_s - other.at_s) > SAME_FALL_S for other in reported)]
    return sorted([*reported, *extra], key=lambda fall: fall.at_s)
