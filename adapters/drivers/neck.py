"""The robot's neck by the operator's head, as in stock TWIST2: two joints, turned 1.5 times as far as the head is.

Yaw grows to the right and pitch upwards, which is what stock's angles are in the frame of its headset (x right, y up, z
back): yaw is the second of the Euler angles x y z, negated, and pitch the first. Ours are those of where the head is
looking, whatever it is tilted by; of a head that is not tilted they are the same.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from adapters.commands.hands import LIMIT_RAD, RATE_RAD_S
from adapters.robots.g1 import twist_keys
from station import rotations
from station.protocols import Floats

SCALE = 1.5
"""How far the neck turns for each radian of the head, in stock TWIST2."""


class Neck:
    """Two joints that follow a head, and stay where they were when it does not lead.

    A neck that is taken up elsewhere comes gently to where the operator looks.

    Args:
        scale: How far they turn for each radian of the head.
    """

    def __init__(self, scale: float = SCALE) -> None:
        self._scale = scale
        self._q = np.zeros(2)

    @property
    def command(self) -> Mapping[str, Floats]:
        """Yaw and pitch by bus key, shape (2,) [rad]."""
        return {twist_keys.action_neck(): self._q.copy()}

    def follow(self, chest_wxyz: Floats, head_wxyz: Floats, dt_s: float) -> None:
        """Go on for a period [s] towards what a head does on a chest; both look along their x and have z upwards."""
        relative = rotations.multiply(rotations.inverse(chest_wxyz), head_wxyz)
        _, down_rad, left_rad = rotations.roll_pitch_yaw(relative).tolist()
        wanted = np.clip(-self._scale * np.array([left_rad, down_rad]), -LIMIT_RAD, LIMIT_RAD)
        reach = RATE_RAD_S * dt_s
        self._q = self._q + np.clip(wanted - self._q, -reach, reach)
