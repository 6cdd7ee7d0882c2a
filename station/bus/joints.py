"""Joint names of the wire: how TWIST and TWIST2 list the joints of a Unitree G1, trackers those of a person, arms.

The order is part of the wire format, so it stands here; limits, gains and masses are in `adapters.robots.g1`.
Source: `facts` of YanjieZe/TWIST and amazon-far/TWIST2, checked against `g1_sim2sim_29dof.xml`; for the person SMPL's
24 joints, as XRoboToolkit lists them, and the hand joints of OpenXR.
"""

from __future__ import annotations

_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")
_WRIST = ("wrist_roll", "wrist_pitch", "wrist_yaw")
_WAIST = ("waist_yaw", "waist_roll", "waist_pitch")


def _sided(names: tuple[str, ...], side: str) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for name in names)


LEGS = _sided(_LEG, "left") + _sided(_LEG, "right")

G1_29 = LEGS + _WAIST + _sided(_ARM + _WRIST, "left") + _sided(_ARM + _WRIST, "right")
"""Unitree's motor order 0-28; TWIST2's joints."""

G1_23 = LEGS + _WAIST + _sided(_ARM, "left") + _sided(_ARM, "right")
"""Joints of TWIST's policy: no wrists."""

G1_25 = LEGS + _WAIST + _sided((*_ARM, "wrist_roll"), "left") + _sided((*_ARM, "wrist_roll"), "right")
"""Joints of TWIST's command: each arm with its wrist roll."""

HAND_LEFT = ("thumb_0", "thumb_1", "thumb_2", "middle_0", "middle_1", "index_0", "index_1")
HAND_RIGHT = ("thumb_0", "thumb_1", "thumb_2", "index_0", "index_1", "middle_0", "middle_1")
"""Dex3-1 joints in the order of TWIST2's hand driver; the two sides differ."""


def hand(side: str) -> tuple[str, ...]:
    """Return the seven joints of one Dex3-1 hand, side included in the names."""
    return _sided(HAND_LEFT if side == "left" else HAND_RIGHT, f"{side}_hand")


ARM_7 = tuple(f"joint_{number}" for number in range(1, 8))
"""Joints of a seven-axis arm, from its base to its flange."""

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
