"""Where the operator's world lies in the robot's: moved along when tracking jumps, so that the robot does not.

Heading and place over the floor are not commanded; only their changes are. A headset that is centred anew, or a body
that is found again a metre further on, must not look like a leap.
"""

from __future__ import annotations

import math

import numpy as np

from station import rotations
from station.operator.sample import Body
from station.protocols import Floats

JUMP_M = 0.3
JUMP_RAD = math.radians(45.0)
"""A larger change between two samples is an error of the tracking, not a movement."""

_PELVIS = 0


class Anchor:
    """Places bodies in one continuous world."""

    def __init__(self) -> None:
        self.jumps = 0
        """How often the operator's world was moved."""
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next body stands where it says."""
        self._turn = np.array([1.0, 0.0, 0.0, 0.0])
        self._shift = np.zeros(3)
        self._last: Body | None = None

    def step(self, body: Body, *, moved: bool = False) -> Body:
        """Return the body in the continuous world.

        Args:
            body: As tracked.
            moved: Whether its place is known to mean nothing, as after a pause in tracking.
        """
        placed = self._placed(body)
        if self._last is not None and (moved or _jumped(self._last, placed)):
            self.jumps += 1
            self._move_onto(body, self._last)
            placed = self._placed(body)
        self._last = placed
        return placed

    def _placed(self, body: Body) -> Body:
        return Body(
            rotations.rotate(self._turn[None], body.positions) + self._shift,
            rotations.multiply(self._turn[None], body.quats_wxyz),
        )

    def _move_onto(self, body: Body, last: Body) -> None:
        """Choose the world in which this body's pelvis is where the last one's was, and looks where that looked."""
        turn = heading(last.quats_wxyz[_PELVIS]) - heading(body.quats_wxyz[_PELVIS])
        self._turn = rotations.from_rotation_vector(np.array([0.0, 0.0, turn]))
        self._shift = last.positions[_PELVIS] - rotations.rotate(self._turn, body.positions[_PELVIS])


def heading(quat_wxyz: Floats) -> float:
    """Return the angle about the vertical [rad] of what turns nothing but that; well defined however it leans."""
    w, _, _, z = quat_wxyz.tolist()
    return 2.0 * math.atan2(z, w)


def _jumped(last: Body, now: Body) -> bool:
    if np.linalg.norm(now.positions[_PELVIS] - last.positions[_PELVIS]) > JUMP_M:
        return True
    turned = rotations.multiply(now.quats_wxyz[_PELVIS], rotations.inverse(last.quats_wxyz[_PELVIS]))
    return bool(np.linalg.norm(rotations.rotation_vector(turned)) > JUMP_RAD)
