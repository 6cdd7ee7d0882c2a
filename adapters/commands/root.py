"""Where TWIST2's whole-body commands take the root: they say its velocities, and neither heading nor place."""

from __future__ import annotations

import math

import numpy as np

from adapters.policies import heading
from station.protocols import Floats
from station.rotations import from_roll_pitch_yaw, rotate, rotate_inverse

_LEAST_UPRIGHT = 0.2  # of the root's z along the world's; below, a velocity along it says nothing of the height


class CommandedRoot:
    """Sums up commands, from the origin, looking ahead.

    Attributes:
        position: In the world of the first command, z above ground, shape (3,) [m].
        quat_wxyz: Orientation there, shape (4,).
    """

    def __init__(self) -> None:
        self.position: Floats = np.zeros(3)
        self.quat_wxyz: Floats = np.array([1.0, 0.0, 0.0, 0.0])
        self._heading = 0.0
        self._before: tuple[float, float] | None = None  # height and pitch

    def advance(self, command: Floats, dt_s: float) -> None:
        """Go on by a command, shape (35,), for a period [s]; its height and lean hold at the end of it."""
        vx, vy, height, roll, pitch, yaw_rate = command[:6].tolist()
        rising, pitching = 0.0, 0.0
        if self._before is not None and dt_s > 0.0:
            rising, pitching = (height - self._before[0]) / dt_s, (pitch - self._before[1]) / dt_s
        self._before = height, pitch
        turned = float(heading.rate(roll, pitch, pitching, yaw_rate)) * dt_s
        self._heading = math.remainder(self._heading + turned, math.tau)
        self.quat_wxyz = from_roll_pitch_yaw([roll, pitch, self._heading])
        # The velocity along the root's own z, which a command does not say, is the one that rises as its height does.
        up = rotate_inverse(self.quat_wxyz, (0.0, 0.0, 1.0))
        vz = (rising - up[0] * vx - up[1] * vy) / max(float(up[2]), _LEAST_UPRIGHT)
        moved = rotate(self.quat_wxyz, (vx, vy, vz))[:2] * dt_s
        self.position = np.append(self.position[:2] + moved, height)
