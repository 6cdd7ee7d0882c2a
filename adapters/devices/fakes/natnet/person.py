"""The fake's actor: a person's body as the bones of Motive's skeleton, in Motive's world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.captures.geometry import Y_TO_Z_UP
from adapters.devices.natnet import wire
from adapters.retarget import frames
from adapters.retarget.human import INDEX, Proportions, standing
from station import rotations
from station.protocols import Floats

NAME, ID = "Ada", 7

_LIMBS = (
    ("Shoulder", "Chest", "collar"), ("UArm", "Shoulder", "shoulder"), ("FArm", "UArm", "elbow"),
    ("Hand", "FArm", "wrist"), ("Thigh", "Hip", "hip"), ("Shin", "Thigh", "knee"), ("Foot", "Shin", "ankle"),
    ("Toe", "Foot", "foot"),
)  # fmt: skip
_TRUNK = (
    ("Hip", "", "pelvis"), ("Ab", "Hip", "spine1"), ("Chest", "Ab", "spine3"), ("Neck", "Chest", "neck"),
    ("Head", "Neck", "head"),
)  # fmt: skip
BONES = _TRUNK + tuple(
    (side[0].upper() + bone, parent if parent in ("Chest", "Hip") else side[0].upper() + parent, f"{side}_{joint}")
    for side in ("left", "right")
    for bone, parent, joint in _LIMBS
)
"""Motive's 21 bones, each with its parent and the joint of a body where it is."""

_PLACE = {bone: index for index, (bone, _, _) in enumerate(BONES)}
_JOINTS = [INDEX[joint] for _, _, joint in BONES]
_PARENTS = [_PLACE.get(parent, -1) for _, parent, _ in BONES]


def described(lengths: Proportions, name: str = NAME, id_: int = ID) -> wire.Skeleton:
    """Return what Motive says of a person of some lengths."""
    at = _place(standing(lengths, arms="out").positions)
    offsets = [place - at[parent] if parent >= 0 else place for place, parent in zip(at, _PARENTS, strict=True)]
    return wire.Skeleton(name, id_, tuple(
        wire.Bone(f"{name}_{bone}", _PLACE[bone] + 1, parent + 1, (float(o[0]), float(o[1]), float(o[2])))
        for (bone, _, _), parent, o in zip(BONES, _PARENTS, offsets, strict=True)
    ))  # fmt: skip


def seen(positions: Floats, quats_wxyz: Floats, *, is_local: bool) -> NDArray[Any]:
    """Return the bones of n frames, all tracked, shape (n, 21) of dtype `adapters.devices.natnet.wire.BONE`.

    Args:
        positions: Of the joints of bodies in our world, shape (n, 24, 3) [m].
        quats_wxyz: Their orientations, shape (n, 24, 4).
        is_local: Whether bones are in their parents' frames, or in the world.
    """
    at, quats = _place(positions), quats_wxyz[:, _JOINTS]
    quats = np.concatenate([quats[..., :1], quats[..., 1:] @ Y_TO_Z_UP], axis=-1)
    if is_local:
        inner = [index for index, parent in enumerate(_PARENTS) if parent >= 0]
        above = [_PARENTS[index] for index in inner]
        world_at, world = at.copy(), quats.copy()
        at[:, inner] = rotations.rotate_inverse(world[:, above], world_at[:, inner] - world_at[:, above])
        quats[:, inner] = rotations.multiply(rotations.inverse(world[:, above]), world[:, inner])
    rows = np.zeros(at.shape[:2], wire.BONE)
    rows["id"] = np.arange(1, len(BONES) + 1)
    rows["position"], rows["quat_xyzw"] = at, frames.xyzw(quats)
    rows["error"], rows["flags"] = 0.001, wire.TRACKED
    return rows


def _place(positions: Floats) -> Floats:
    return np.asarray(positions[..., _JOINTS, :] @ Y_TO_Z_UP)
