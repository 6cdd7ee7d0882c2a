"""Falls: those that a server reported, and those that the recorded pose shows."""

from __future__ import annotations

import math

from station.episode.quality.findings import FallSeen
from station.protocols import FALL_TILT_RAD, Floats

UPRIGHT_RAD = math.radians(45.0)
"""A fall is over, and a next one may begin, when the root leans less than this."""
SAME_FALL_S = 3.0  # a touch of the ground is reported at once, the tilt follows within a second or two


def from_pose(robot: str, times_s: Floats, tilt_rad: Floats) -> list[FallSeen]:
    """Return each time the tilt went beyond the limit; a next one counts only after the robot was upright again.

    Args:
        robot: Suffix of the robot.
        times_s, tilt_rad: Time from the start of the episode, and tilt of the root, shape (n,).
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
