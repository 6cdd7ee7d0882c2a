"""Joint names of a person, as trackers list them; the order is part of the wire format.

The body has SMPL's 24 in XRoboToolkit's order, a hand the 26 of OpenXR.
"""

from __future__ import annotations

SMPL_24 = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
"""Joints of a person's body."""

SMPL_24_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
"""Index of the joint that carries each; -1 for the pelvis. A bone's orientation stands at its joint nearer the root."""

_FINGERS = tuple(
    f"{finger}_{joint}"
    for finger in ("thumb", "index", "middle", "ring", "little")
    for joint in ("metacarpal", "proximal", "intermediate", "distal", "tip")
    if (finger, joint) != ("thumb", "intermediate")
)
HAND_26 = ("palm", "wrist", *_FINGERS)
"""Joints of a person's hand, in OpenXR's order."""
