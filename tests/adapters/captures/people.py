"""Whom the tests of captures write to files."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from adapters.retarget.human import INDEX
from adapters.retarget.skeleton_file import Skeletons
from station import rotations
from station.protocols import Floats
from tests.adapters.retarget.people import doing

PARTS = ("pelvis", "spine3", "left_ankle", "right_ankle", "left_wrist", "right_wrist")
"""Joints whose orientations retargeting asks for."""

LIMBS = tuple(f"{side}_{name}" for side in ("left", "right")
              for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"))  # fmt: skip


@lru_cache(maxsize=4)
def moving(clip: str, seconds: float = 3.0, start_s: float = 1.0) -> Skeletons:
    """Return a part of what a person of 1.72 m does."""
    person = doing(clip)
    cut = (person.times_s >= start_s) & (person.times_s < start_s + seconds)
    return Skeletons(
        person.positions[cut], person.quats_wxyz[cut], person.times_s[cut] - person.times_s[cut][0], person.height_m
    )


def place_error_m(found: Skeletons, person: Skeletons) -> dict[str, float]:
    """Return how far joints of the limbs are from where they are, seen from the hips, the mean by joint [m]."""
    ours, theirs = _from_hips(found), _from_hips(person)
    return {name: float(np.linalg.norm(ours - theirs, axis=-1)[:, INDEX[name]].mean()) for name in LIMBS}


def turn_error_rad(found: Skeletons, person: Skeletons) -> dict[str, float]:
    """Return how far orientations are from what they are, the greatest by joint [rad]."""
    rows = [INDEX[name] for name in PARTS]
    off = rotations.multiply(rotations.inverse(person.quats_wxyz[:, rows]), found.quats_wxyz[:, rows])
    return dict(zip(PARTS, np.linalg.norm(rotations.rotation_vector(off), axis=-1).max(axis=0).tolist(), strict=True))


def _from_hips(person: Skeletons) -> Floats:
    hips = person.positions[:, [INDEX["left_hip"], INDEX["right_hip"]]].mean(axis=1, keepdims=True)
    return np.asarray(person.positions - hips)
