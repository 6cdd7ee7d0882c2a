"""One person who moves, written as BVH, as AMASS and as C3D, each by the public description of its format."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adapters.captures import amass
from adapters.captures.geometry import turn_between
from adapters.retarget.human import HANGING, INDEX, SIDES, of_height, standing
from adapters.retarget.skeleton_file import Skeletons
from adapters.robots.g1.kinematics import about, matrix
from station import rotations
from station.bus.joints import SMPL_24, SMPL_24_PARENTS
from station.protocols import Floats

Y_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""From our world to one with x left, y up, z forward."""

MIXAMO = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
    **{f"{side}_{ours}": f"{side.capitalize()}{theirs}" for side in SIDES for ours, theirs in (
        ("hip", "UpLeg"), ("knee", "Leg"), ("ankle", "Foot"), ("foot", "ToeBase"), ("collar", "Shoulder"),
        ("shoulder", "Arm"), ("elbow", "ForeArm"), ("wrist", "Hand"), ("hand", "HandMiddle1"))},
}  # fmt: skip
"""What MotionBuilder and Mixamo call the joints."""

SMPL = {name: f"{name[0].upper()}_{name.partition('_')[2].capitalize()}" if "_" in name else name.capitalize()
        for name in SMPL_24}  # fmt: skip

XSENS = {
    "pelvis": "Hips", "spine1": "Chest", "spine2": "Chest2", "spine3": "Chest4", "neck": "Neck", "head": "Head",
    **{f"{side}_{ours}": f"{side.capitalize()}{theirs}" for side in SIDES for ours, theirs in (
        ("hip", "Hip"), ("knee", "Knee"), ("ankle", "Ankle"), ("foot", "Toe"), ("collar", "Collar"),
        ("shoulder", "Shoulder"), ("elbow", "Elbow"), ("wrist", "Wrist"), ("hand", "Hand1"))},
}  # fmt: skip

BLENDER = {
    "pelvis": "hips", "spine1": "spine.001", "spine2": "spine.002", "spine3": "chest", "neck": "neck", "head": "head",
    **{f"{side}_{ours}": f"{theirs}.{side[0].upper()}" for side in SIDES for ours, theirs in (
        ("hip", "thigh"), ("knee", "shin"), ("ankle", "foot"), ("foot", "toe"), ("collar", "clavicle"),
        ("shoulder", "upper_arm"), ("elbow", "forearm"), ("wrist", "hand"), ("hand", "fingers"))},
}  # fmt: skip


def turns_of(person: Skeletons) -> Floats:
    """Return the orientations of all joints, shape (n, 24, 3, 3)."""
    return matrix(person.quats_wxyz)


def zero_pose(kind: str) -> Floats:
    """Return the orientation of each joint in a pose of zero rotations, shape (24, 3, 3): ``t``, ``hanging`` arms, or
    ``none``, which is no pose of a person."""
    zero = np.tile(np.eye(3), (24, 1, 1))
    if kind == "hanging":
        for number, side in enumerate(SIDES):
            for joint in ("shoulder", "elbow", "wrist", "hand"):
                zero[INDEX[f"{side}_{joint}"]] = HANGING[number]
    if kind == "none":
        zero = matrix(rotations.normalized(np.random.default_rng(7).normal(size=(24, 4))))
    return zero


def write_bvh(
    path: Path, person: Skeletons, *, order: str = "ZXY", unit_m: float = 0.01, world: Floats = Y_UP, zero: str = "t",
    names: Mapping[str, str] = MIXAMO, prefix: str = "",
) -> Path:  # fmt: skip
    """Write a person as BVH; `order` is that of the rotation channels, `world` takes our axes to the file's."""
    rest = standing(of_height(person.height_m)).positions
    at_zero = zero_pose(zero)
    file_turns = world @ turns_of(person) @ at_zero.swapaxes(-1, -2) @ world.T
    columns = [world @ person.positions[:, 0].T / unit_m]
    lines = ["HIERARCHY"]

    def put(joint: int, depth: int) -> None:
        pad, parent = "  " * depth, SMPL_24_PARENTS[joint]
        carried = np.zeros(3) if parent < 0 else at_zero[parent] @ (rest[joint] - rest[parent])
        places = "Xposition Yposition Zposition " if parent < 0 else ""
        channels = " ".join(f"{axis}rotation" for axis in order)
        lines.extend([
            f"{pad}{'ROOT' if parent < 0 else 'JOINT'} {prefix}{names[SMPL_24[joint]]}", f"{pad}{{",
            f"{pad}  OFFSET {' '.join(f'{x:.7f}' for x in world @ carried / unit_m)}",
            f"{pad}  CHANNELS {6 if parent < 0 else 3} {places}{channels}",
        ])  # fmt: skip
        local = file_turns[:, joint]
        if parent >= 0:
            local = file_turns[:, parent].swapaxes(-1, -2) @ local
        columns.append(np.degrees(euler(local, order)))
        children = [child for child, its in enumerate(SMPL_24_PARENTS) if its == joint]
        for child in children:
            put(child, depth + 1)
        if not children:
            lines.extend([f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET 0 0 1", f"{pad}  }}"])
        lines.append(f"{pad}}}")

    put(0, 0)
    frame_s = float(np.diff(person.times_s).mean())
    lines += ["MOTION", f"Frames: {len(person)}", f"Frame Time: {frame_s:.8f}"]
    lines += [" ".join(f"{value:.7f}" for value in row) for row in np.vstack(columns).T]
    path.write_text("\n".join(lines) + "\n")
    return path


def euler(turns: Floats, order: str) -> Floats:
    """Return the angles whose rotations, multiplied in order, are `turns`, shape (3, n) [rad]."""
    a, b, c = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if order in ("XYZ", "YZX", "ZXY") else -1.0
    second = np.arcsin(np.clip(sign * turns[:, a, c], -1.0, 1.0))
    return np.stack([
        np.arctan2(-sign * turns[:, b, c], turns[:, c, c]), second, np.arctan2(-sign * turns[:, a, b], turns[:, a, a]),
    ])  # fmt: skip


def amass_members(person: Skeletons) -> dict[str, Any]:
    """Return what an AMASS file of a person holds: rotations from the model's zero pose, the world's z up."""
    zero = amass.rest(person.height_m)
    rest = standing(of_height(person.height_m)).positions[:22] @ Y_UP.T
    turns = turns_of(person)[:, :22] @ Y_UP.T  # from the axes of the zero pose to our world
    for side in SIDES:  # these bones are not where ours are in the zero pose
        for joint, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow")):
            begin, finish = INDEX[f"{side}_{joint}"], INDEX[f"{side}_{end}"]
            turns[:, begin] = turns[:, begin] @ turn_between(zero[finish] - zero[begin], rest[finish] - rest[begin])
    poses = np.zeros((len(person), 52, 3))
    for joint in range(22):
        parent = SMPL_24_PARENTS[joint]
        local = turns[:, joint] if parent < 0 else turns[:, parent].swapaxes(-1, -2) @ turns[:, joint]
        poses[:, joint] = vectors(local)
    rate = 1.0 / float(np.diff(person.times_s).mean())
    return {
        "poses": poses.reshape(len(person), -1), "trans": person.positions[:, 0], "mocap_framerate": np.array(rate),
        "gender": np.array("male"), "betas": np.zeros(16), "dmpls": np.zeros((len(person), 8)),
    }  # fmt: skip


def write_amass(path: Path, person: Skeletons, **changes: Any) -> Path:
    """Write a person as AMASS does; members given as None are left out."""
    members = amass_members(person) | changes
    np.savez(path, **{name: value for name, value in members.items() if value is not None})
    return path


def vectors(turns: Floats) -> Floats:
    """Return the rotation vectors of matrices, shape (n, 3) [rad]."""
    from adapters.retarget.bone_frames import to_quats

    return rotations.rotation_vector(to_quats(turns))


def markers_of(person: Skeletons) -> dict[str, Floats]:
    """Return the markers of Plug-in Gait on a person, by label, shape (n, 3) [m]: on the skin, beside the joints."""
    at = {name: person.positions[:, index] for name, index in INDEX.items()}
    turn = {name: turns_of(person)[:, index] for name, index in INDEX.items()}
    pelvis = turn["pelvis"] @ about("y", np.array(np.radians(12.0)))
    hips = 0.5 * (at["left_hip"] + at["right_hip"])
    half = float(np.linalg.norm(at["left_hip"] - at["right_hip"], axis=1).mean()) / 2.0
    width, depth = (half - 0.0073) / 0.33, 0.15  # Harrington's regression, from the other side
    front = hips + pelvis @ (0.24 * depth + 0.0099, 0.0, 0.30 * width + 0.0109)
    chest, neck, head = turn["spine3"], at["neck"], at["head"]
    markers = {
        "C7": neck + chest @ (-0.07, 0.0, 0.02), "CLAV": neck + chest @ (0.07, 0.0, -0.02),
        "T10": neck + chest @ (-0.09, 0.0, -0.22), "STRN": neck + chest @ (0.09, 0.0, -0.22),
        "RBAK": neck + chest @ (-0.1, -0.1, -0.1),
    }  # fmt: skip
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        letter = side[0].upper()
        foot, upper, hand = turn[f"{side}_ankle"], turn[f"{side}_shoulder"], turn[f"{side}_wrist"]
        ankle, wrist = at[f"{side}_ankle"], at[f"{side}_wrist"]
        markers |= {
            f"{letter}ASI": front + pelvis @ (0.0, sign * width / 2.0, 0.0),
            f"{letter}PSI": front + pelvis @ (-depth, sign * 0.05, 0.0),
            f"{letter}KNE": at[f"{side}_knee"] + turn[f"{side}_knee"] @ (0.0, sign * 0.05, 0.0),
            f"{letter}ANK": ankle + foot @ (0.0, sign * 0.04, 0.0),
            f"{letter}HEE": ankle + foot @ (-0.05, 0.0, -0.04),
            f"{letter}TOE": ankle + foot @ (0.16, 0.0, -0.04),
            f"{letter}SHO": at[f"{side}_shoulder"] + chest @ (0.0, 0.0, 0.047),
            f"{letter}ELB": at[f"{side}_elbow"] + upper @ (0.0, 0.0, 0.04),
            f"{letter}WRA": wrist + hand @ (0.03, 0.0, 0.0),
            f"{letter}WRB": wrist + hand @ (-0.03, 0.0, 0.0),
            f"{letter}FIN": wrist + hand @ (0.0, sign * 0.08, 0.0),
            f"{letter}FHD": head + chest @ (0.08, sign * 0.07, 0.04),
            f"{letter}BHD": head + chest @ (-0.08, sign * 0.07, 0.04),
        }
    return markers


def write_c3d(
    path: Path, person: Skeletons, *, unit: str = "mm", unit_m: float = 0.001, scale: float = -1.0,
    hidden: Mapping[str, slice] | None = None, left_out: Sequence[str] = (), prefix: str = "",
) -> Path:  # fmt: skip
    """Write a person's markers as C3D; `scale` above zero keeps them as integers of so many units."""
    markers = {label: points for label, points in markers_of(person).items() if label not in left_out}
    points = np.stack(list(markers.values()), axis=1) / unit_m
    residual = np.zeros(points.shape[:2])
    for label, frames in (hidden or {}).items():
        residual[frames, list(markers).index(label)] = -1.0
        points[frames, list(markers).index(label)] = 0.0
    rate = 1.0 / float(np.diff(person.times_s).mean())
    path.write_bytes(c3d_bytes([prefix + label for label in markers], points, residual, rate, unit, scale))
    return path


def c3d_bytes(
    labels: Sequence[str], points: Floats, residual: Floats, rate: float, unit: str, scale: float = -1.0
) -> bytes:
    """Return a C3D file for an Intel processor: header, parameters, 3-D points."""
    count = len(points)
    groups: dict[str, dict[str, tuple[int, Any]]] = {
        "POINT": {
            "USED": (2, len(labels)), "SCALE": (4, scale), "RATE": (4, rate), "DATA_START": (2, 0),
            "FRAMES": (2, count), "LABELS": (-1, labels), "UNITS": (-1, unit),
        },
        "ANALOG": {"USED": (2, 0)},
    }  # fmt: skip
    size = len(_parameters(groups))
    groups["POINT"]["DATA_START"] = (2, 2 + size // 512)
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, len(labels), 0, 1, count, 10, scale, 2 + size // 512, 0, rate)
    if scale < 0.0:
        data = np.concatenate([points, residual[..., None]], axis=-1).astype("<f4").tobytes()
    else:
        rows = np.concatenate([np.round(points / scale), residual[..., None]], axis=-1)
        data = rows.astype("<i2").tobytes()
    body = header.ljust(512, b"\0") + _parameters(groups) + data
    return body + b"\0" * (-len(body) % 512)


def _parameters(groups: Mapping[str, Mapping[str, tuple[int, Any]]]) -> bytes:
    records = b""
    for number, (group, parameters) in enumerate(groups.items(), start=1):
        records += struct.pack("<bb", len(group), -number) + group.encode() + struct.pack("<hB", 3, 0)
        for name, (kind, value) in parameters.items():
            data = _value(kind, value)
            records += (
                struct.pack("<bb", len(name), number) + name.encode() + struct.pack("<h", 3 + len(data)) + data + b"\0"
            )
    blocks = -(-(len(records) + 6) // 512)
    return (struct.pack("<BBBB", 1, 0x50, blocks, 84) + records).ljust(blocks * 512, b"\0")


def _value(kind: int, value: Any) -> bytes:
    if kind == -1 and isinstance(value, str):
        return struct.pack("<bBB", kind, 1, len(value)) + value.encode()
    if kind == -1:
        wide = max(map(len, value))
        return struct.pack("<bBBB", kind, 2, wide, len(value)) + b"".join(each.ljust(wide).encode() for each in value)
    return struct.pack("<bB" + {2: "h", 4: "f"}[kind], kind, 0, value)
