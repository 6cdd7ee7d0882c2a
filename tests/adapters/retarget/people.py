"""People, and what the tests look at of them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from adapters.motions.load import load
from adapters.retarget.human import Proportions, of_height
from adapters.retarget.played import person_of
from adapters.retarget.skeleton_file import Skeletons
from station import rotations
from station.operator.sample import Body
from station.protocols import Floats

PERIOD_NS = 11_111_111
"""Of a headset at 90 Hz [ns]."""

ADULT = of_height(1.72)


@lru_cache(maxsize=16)
def doing(clip: str, height_m: float | None = 1.72) -> Skeletons:
    """Return the person who does a built-in clip."""
    return person_of(load(f"builtin:{clip}"), height_m)


def moved(body: Body, shift: tuple[float, float, float], turn_rad: float = 0.0) -> Body:
    """Return a body elsewhere: turned about the world's vertical, then shifted [m]."""
    turn = rotations.from_rotation_vector(np.array([0.0, 0.0, turn_rad]))
    return Body(
        rotations.rotate(turn[None], body.positions) + np.array(shift),
        rotations.multiply(turn[None], body.quats_wxyz),
    )


def bone_lengths(positions: Floats) -> Floats:
    """Return the length of each bone in each frame, shape (n, 23) [m]."""
    from station.bus.joints import SMPL_24_PARENTS

    return np.asarray(np.linalg.norm(positions[:, 1:] - positions[:, list(SMPL_24_PARENTS[1:])], axis=-1))


def longer_arms(lengths: Proportions, factor: float) -> Proportions:
    """Return the same body with other arms."""
    from dataclasses import replace

    return replace(lengths, upper_arm=lengths.upper_arm * factor, forearm=lengths.forearm * factor)
