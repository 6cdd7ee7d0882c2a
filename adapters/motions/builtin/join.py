"""One motion after the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.motions.builtin.body import FORMAT
from adapters.motions.builtin.profiles import FPS
from adapters.motions.raw import RawMotion
from station import rotations
from station.errors import UsageError


def join(*motions: RawMotion, name: str = "joined") -> RawMotion:
    """Return motions that begin and end in the standing pose as one, each going on where the one before stood still.

    Args:
        motions: At the frame rate of this package.
        name: Of the result.

    Raises:
        UsageError: no motion.
    """
    if not motions:
        raise UsageError(f"{name}: nothing to join; give at least one motion")
    position, quats, q = [motions[0].root_pos], [motions[0].root_quat_wxyz], [motions[0].q]
    for motion in motions[1:]:
        turn = rotations.multiply(quats[-1][-1], rotations.inverse(motion.root_quat_wxyz[0]))
        shift = position[-1][-1] - rotations.rotate(turn, motion.root_pos[0])
        position.append(rotations.rotate(turn, motion.root_pos[1:]) + shift)
        quats.append(rotations.multiply(turn, motion.root_quat_wxyz[1:]))
        q.append(motion.q[1:])
    return RawMotion(Path(name), FORMAT, FPS, np.concatenate(position), np.concatenate(quats), np.concatenate(q))
