"""How long each element of a command takes back to standing: a velocity fades at once, all else is blended."""

from __future__ import annotations

import numpy as np

from station.protocols import CommandFormat, Floats

VELOCITY_FADE_S = 0.2
"""Time in which velocities fade to zero [s], where commands are lost and where a command server ends them.

Figures are in docs/reliability.md: blended over 2 s, as poses are, they take a walking robot twice as far.
"""


def times_to_standing(command_format: CommandFormat, blend_s: float) -> Floats:
    """Return the time that each element takes, shape (m,) [s]: `VELOCITY_FADE_S` at most for velocities."""
    times_s = np.full(len(command_format.default), blend_s)
    times_s[list(command_format.velocities)] = min(blend_s, VELOCITY_FADE_S)
    return times_s
