"""AMASS and SMPL-X: a numpy ``.npz`` archive (no pickle inside) with the joint rotations of a body model.

| member | shape, type | content |
|---|---|---|
| ``poses`` | (n, 66 or more) float | rotation vectors of joints in their parents' frames, SMPL's 22 in front [rad] |
| ``trans`` | (n, 3) float | where the body is [m] |
| ``mocap_framerate`` or ``mocap_frame_rate`` | () number | frames per second |
| ``gender`` | () text | decides how tall the person is taken to be where the user does not say; may be absent |

The body model itself is licensed and not here, so its shape (``betas``) cannot be turned into lengths: a mean skeleton
of ours is posed, as tall as the user says. Other members are not read. In place of ``poses`` there may be
``root_orient`` (n, 3) and ``pose_body`` (n, 63).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from adapters.captures.geometry import Y_TO_Z_UP
from adapters.captures.joints import MOST_FRAMES, Joints
from adapters.motions import npz_archive, raw
from adapters.retarget.human import INDEX, SIDES, of_height, standing
from adapters.robots.g1.kinematics import about, matrix
from station import rotations
from station.bus.joints import SMPL_24, SMPL_24_PARENTS
from station.errors import BadFile
from station.protocols import Floats

JOINTS = 22
"""Of the body, without fingers and face; they are the first of `station.bus.joints.SMPL_24`."""

RATES = ("mocap_framerate", "mocap_frame_rate")
HEIGHTS_M = {"male": 1.76, "female": 1.63, "neutral": 1.70}
"""Adults, about [m]."""

_READ = ("poses", "root_orient", "pose_body", "trans", *RATES)
_ZERO_POSE_DEG = {"knee": (5.0, 0.0, 0.0), "ankle": (-2.0, 6.0, 0.0), "elbow": (-3.0, 0.0, 6.0)}
"""How the bones above these left joints are turned about x, y and z in the model's zero pose, about: thighs outwards,
shanks inwards and back, upper arms down and back. Those of ours are straight."""


def load(path: Path, *, height_m: float | None = None) -> Joints:
    """Read a person.

    Args:
        path: The file.
        height_m: How tall the person is [m]; None for the mean of the gender.

    Raises:
        BadFile: missing, torn, too large, or without these members.
    """
    members = _members(path, raw.read_bytes(path))
    poses, places = _poses(path, members), _numbers(path, members, "trans", 3)
    rate = next((members[name] for name in RATES if name in members), np.zeros(0))
    if rate.size != 1 or rate.dtype.kind not in "fiu":
        raise BadFile(f"{path}: no rate; expected one number of frames per second as {' or '.join(RATES)}")
    gender = _gender(members.get("gender"))
    tall_m = height_m or HEIGHTS_M[gender]
    if len(poses) != len(places) or len(poses) > MOST_FRAMES:
        raise BadFile(f"{path}: {len(poses)} poses and {len(places)} places; expected equal numbers, to {MOST_FRAMES}")
    at, turns = _posed(rest(tall_m), poses, places)
    names = {"ball": "foot"}
    named = {
        f"{side}_{name}": at[:, INDEX[f"{side}_{names.get(name, name)}"]]
        for side in SIDES
        for name in ("hip", "knee", "ankle", "ball", "shoulder", "elbow", "wrist")
    }
    bodies = turns @ Y_TO_Z_UP.T
    parts = {"pelvis": "pelvis", "chest": "spine3"} | {
        f"{side}_{part}": f"{side}_{joint}" for side in SIDES for part, joint in (("foot", "ankle"), ("hand", "wrist"))
    }
    told = "" if height_m else f", a {gender} adult; --height says better"
    return Joints(
        path=path,
        fps=float(rate.reshape(-1)[0]),
        places=named | {"neck": at[:, INDEX["neck"]], "head": at[:, INDEX["head"]]},
        turns={part: bodies[:, INDEX[joint]] for part, joint in parts.items()},
        unit_m=1.0,
        height_m=tall_m,
        notes=(f"the shape of the body is not read: a mean skeleton of {tall_m:g} m{told}",),
    )


def rest(height_m: float) -> Floats:
    """Return where the joints are in the model's zero pose, shape (22, 3) [m]: x left, y up, z forward, the pelvis at
    the origin; lengths are those of `adapters.retarget.human.of_height`."""
    ours = standing(of_height(height_m)).positions[:JOINTS]
    placed = np.zeros_like(ours)
    for index, name in enumerate(SMPL_24[1:JOINTS], start=1):
        parent = SMPL_24_PARENTS[index]
        side, _, joint = name.partition("_")
        bone = ours[index] - ours[parent]
        if joint in _ZERO_POSE_DEG:
            mirrored = (1.0, 1.0, 1.0) if side == "left" else (-1.0, 1.0, -1.0)
            for axis, angle in zip("xyz", np.radians(_ZERO_POSE_DEG[joint]) * mirrored, strict=True):
                bone = about(axis, angle) @ bone
        placed[index] = placed[parent] + bone
    return np.asarray(placed @ Y_TO_Z_UP)


def _posed(rest_places: Floats, poses: Floats, places: Floats) -> tuple[Floats, Floats]:
    """Return where the joints are, shape (n, 22, 3) [m], and their rotations from the zero pose, (n, 22, 3, 3)."""
    local = matrix(rotations.from_rotation_vector(poses))
    at, turns = np.empty((len(poses), JOINTS, 3)), np.empty((len(poses), JOINTS, 3, 3))
    at[:, 0], turns[:, 0] = places, local[:, 0]
    for index in range(1, JOINTS):
        parent = SMPL_24_PARENTS[index]
        at[:, index] = at[:, parent] + turns[:, parent] @ (rest_places[index] - rest_places[parent])
        turns[:, index] = turns[:, parent] @ local[:, index]
    return at, turns


def _poses(path: Path, members: dict[str, Any]) -> Floats:
    """Return the rotation vectors of the body's joints, shape (n, 22, 3) [rad]."""
    if "poses" in members:
        table = _numbers(path, members, "poses", None)
    else:
        table = np.concatenate(
            [_numbers(path, members, name, width) for name, width in (("root_orient", 3), ("pose_body", 63))], axis=1
        )
    if table.shape[1] < 3 * JOINTS or table.shape[1] % 3:
        raise BadFile(f"{path}: poses has shape {table.shape}; expected 3 numbers for each of {JOINTS} joints or more")
    body = table[:, : 3 * JOINTS].reshape(len(table), JOINTS, 3)
    if np.abs(body).max(initial=0.0) > 4.0 * np.pi:
        raise BadFile(
            f"{path}: poses reach {np.abs(body).max():.0f}; expected rotation vectors in radians, not degrees"
        )
    return body


def _numbers(path: Path, members: dict[str, Any], name: str, width: int | None) -> Floats:
    expected = f"numbers of shape (frames, {width or '66 or more'})"
    if name not in members:
        found = "a motion of a robot, which `station rehearse` plays as it is" if "joint_pos" in members else (
            ", ".join(sorted(members))[:100] or "nothing")  # fmt: skip
        raise BadFile(f"{path}: no member {name!r}; expected poses, trans and mocap_framerate; came {found}")
    array = members[name]
    if array.dtype.kind not in "fiu" or array.ndim != 2 or (width is not None and array.shape[1] != width):
        raise BadFile(f"{path}: {name} is {array.dtype} of shape {array.shape}; expected {expected}")
    if not np.isfinite(array).all():
        frame = int((~np.isfinite(array)).any(axis=1).argmax())
        raise BadFile(f"{path}: {name} is not finite in frame {frame} of {len(array)}")
    return np.asarray(array, dtype=np.float64)


def _members(path: Path, data: bytes) -> dict[str, Any]:
    """Return what is needed of an archive; of other members, that they are there."""
    found, names = npz_archive.read(path, data, (*_READ, "gender"), what="AMASS file", ignored=("gender",))
    return {name: None for name in names} | found


def _gender(member: Any) -> str:
    """Return a gender that is known, else ``neutral``; files keep it as text, bytes, or an object, not read here."""
    value = member.reshape(-1)[0] if member is not None and member.size == 1 else ""
    name = value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
    return name if name in HEIGHTS_M else "neutral"
