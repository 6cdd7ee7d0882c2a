"""How far the fingers of a tracked hand are bent, from the places of its joints: a headset's hand as a glove.

Places alone are used: runtimes differ in how they turn the joints of a hand, and agree on where they are.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from adapters.devices.glove.sensors import FINGERS
from station.bus.joints import HAND_26
from station.protocols import Floats

STRAIGHT_RAD = 0.15
"""Bones that are bent by less against each other count as straight: nobody's flat hand is."""

FIST_RAD = np.array([[0.7, 0.9, 1.2], *[[1.4, 1.7, 1.1]] * 4])
"""Of a fist, a row for each finger, from the knuckle to the tip [rad]. Chosen by us; nobody was measured."""

_THUMB = ("wrist", "thumb_metacarpal", "thumb_proximal", "thumb_distal", "thumb_tip")
_BONES = ("metacarpal", "proximal", "intermediate", "distal", "tip")
_CHAINS = np.array([
    [HAND_26.index(name) for name in (_THUMB if finger == "thumb" else [f"{finger}_{bone}" for bone in _BONES])]
    for finger in FINGERS
])  # fmt: skip
"""Places in `HAND_26` along each finger, shape (5, 5)."""


def closed(joints: Floats) -> Floats:
    """Return how far each joint of each finger is closed, 0 open to 1 closed, shape (15,).

    They stand as in a glove of 15 sensors: three for each finger from the thumb on, from the knuckle to the tip.

    Args:
        joints: Poses of `station.bus.joints.HAND_26`, shape (26, 7), places first [m].
    """
    places = joints[_CHAINS, :3]
    bones = [after - before for before, after in pairwise(np.moveaxis(places, 1, 0))]
    bent = np.stack([_angle(before, after) for before, after in pairwise(bones)], axis=1)
    share = (bent - STRAIGHT_RAD) / (FIST_RAD - STRAIGHT_RAD)
    return np.asarray(np.clip(share, 0.0, 1.0).ravel())


def _angle(before: Floats, after: Floats) -> Floats:
    """Return the angle between vectors, shape (5, 3) each [rad]; 0 where one has no length."""
    across = np.linalg.norm(np.cross(before, after), axis=1)
    return np.asarray(np.arctan2(across, np.einsum("ij,ij->i", before, after)))
