"""Synthetic body tracking of a person in the pose of a G1: the ground truth that retargeting is measured against.

Bones point as the robot's links do; lengths are the person's. Paths scale with the length of the legs, and the feet are
put down below the person's own hips, so a foot that the robot holds still is held still.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adapters.retarget.bone_frames import along_y
from adapters.retarget.human import G1_SIZED, Posture, Proportions, assembled, of_height
from adapters.robots.g1 import kinematics
from station.operator.sample import Body
from station.protocols import Floats, Reference

HIP_PITCH_Z = -G1_SIZED.hip_drop
"""Height of the axes of hip pitch in the frame of the pelvis [m]."""

_SIDES = ("left", "right")


def skeleton_of(
    reference: Reference | Floats, height_m: float | None = None, *, lengths: Proportions | None = None
) -> Body:
    """Return the body tracking of a person in the pose of a G1.

    Args:
        reference: What the robot does; or its qpos: position and quaternion wxyz of the root, then the joints of
            `adapters.robots.g1.joints.G1_29`, shape (36,).
        height_m: How tall the person is [m]; None for a person of the robot's own size.
        lengths: The person's lengths, in place of those of an average one of that height.
    """
    if isinstance(reference, Reference):
        root_pos, quat, q = reference.root_pos, reference.root_quat_wxyz, reference.q
    else:
        root_pos, quat, q = reference[:3], reference[3:7], reference[7:]
    chosen = lengths or (G1_SIZED if height_m is None else of_height(height_m))
    positions, quats = skeletons(root_pos[None], quat[None], q[None], chosen)
    return Body(positions[0], quats[0])


def skeletons(root_pos: Floats, root_quat_wxyz: Floats, q: Floats, lengths: Proportions) -> tuple[Floats, Floats]:
    """Return positions (n, 24, 3) [m] and orientations (n, 24, 4) of the person's joints.

    Args:
        root_pos: Positions of the robot's pelvis, shape (n, 3) [m].
        root_quat_wxyz: Its orientations, shape (n, 4).
        q: Joint positions in the order of `adapters.robots.g1.joints.G1_29`, shape (n, 29) [rad].
        lengths: The person's.
    """
    return assembled(posture_of(kinematics.forward(root_pos, root_quat_wxyz, q), lengths), lengths)


def posture_of(links: kinematics.LinkPoses, lengths: Proportions) -> Posture:
    """Return how the bones of the person point when the robot's links are so."""
    scale = lengths.leg / G1_SIZED.leg
    pelvis_turn = _turn(links, "pelvis")
    hips = _at(links, "pelvis") + pelvis_turn @ (0.0, 0.0, HIP_PITCH_Z)
    feet_turn = _both(links, "{}_ankle_roll", _turn)
    elbow_axes = _both(links, "{}_elbow", _turn)[..., 1]
    out = np.array([1.0, -1.0])[:, None, None]  # a right arm's rest frame points away along -y
    elbow, wrist = _both(links, "{}_elbow", _at), _both(links, "{}_wrist_pitch", _at)
    return Posture(
        pelvis=_on_floor(hips, scale, lengths),
        pelvis_turn=pelvis_turn,
        chest_turn=_turn(links, "torso"),
        ankles=_below_own_hips(_both(links, "{}_ankle_roll", _at), feet_turn, scale, lengths),
        feet_turn=feet_turn,
        knees_to=_both(links, "{}_knee", _turn)[..., 0],
        upper_arms_turn=along_y(out * (elbow - _both(links, "{}_shoulder_roll", _at)), out * elbow_axes),
        forearms_turn=along_y(out * (wrist - elbow), out * elbow_axes),
        hands_turn=_both(links, "{}_wrist_yaw", _turn) @ HAND_REST[:, None],
    )


HAND_REST = np.array(
    [
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
    ]
)
"""From the rest frame of a hand to the frame of the robot's (x to the fingers, z to the thumb), shape (2, 3, 3)."""


def _on_floor(points: Floats, scale: float, lengths: Proportions) -> Floats:
    """Scale places of the robot about the plane of its flat ankles, and put that plane at the person's ankles."""
    low, high = np.array([0.0, 0.0, G1_SIZED.ankle_height]), np.array([0.0, 0.0, lengths.ankle_height])
    return np.asarray((points - low) * scale + high)


def _below_own_hips(ankles: Floats, feet_turn: Floats, scale: float, lengths: Proportions) -> Floats:
    """Shift each foot along its own width, by what the person's hips are narrower: it still stands still."""
    sideways = feet_turn[..., 1] * (1.0, 1.0, 0.0)
    narrower = (scale * G1_SIZED.hip_half_width - lengths.hip_half_width) * np.array([-1.0, 1.0])
    return _on_floor(ankles, scale, lengths) + sideways * narrower[:, None, None]


def _at(links: kinematics.LinkPoses, name: str) -> Floats:
    return np.asarray(links.position[kinematics.INDEX[name]])


def _turn(links: kinematics.LinkPoses, name: str) -> Floats:
    return np.asarray(links.rotation[kinematics.INDEX[name]])


def _both(links: kinematics.LinkPoses, name: str, what: Callable[[kinematics.LinkPoses, str], Floats]) -> Floats:
    return np.stack([what(links, name.format(side)) for side in _SIDES])
