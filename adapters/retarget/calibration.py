"""What is known of an operator: lengths of the body, the floor, and how the device's frames sit on the bones.

Measured while the operator stands for a second in a T-pose or with hanging arms, and kept as YAML. Lengths come from
positions alone. Orientations of a device have whatever zero its maker chose; the known pose tells, for each joint, the
turn from there to the rest frame of the bone, so nothing depends on the maker's choice.
"""

from __future__ import annotations

import datetime
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import yaml

from adapters.retarget.human import INDEX, SIDES, Proportions, of_height, standing
from station import rotations
from station.bus.joints import SMPL_24
from station.errors import BadFile, StationError
from station.operator.sample import Body
from station.protocols import Floats

Pose = Literal["t-pose", "standing"]

LEAST_SAMPLES = 20
MEASURE = "measure the operator first: station devices calibrate pico --operator NAME"
STILL_M = 0.03
"""How far a joint may be from its median place while an operator is measured [m]."""

_HEAD = "# An operator's body: lengths and heights in metres, angles in radians, turns as quaternions w x y z.\n"
_ARM_OFF = {"t-pose": math.radians(30.0), "standing": math.radians(40.0)}
_LEAN = math.radians(20.0)
_BENT = math.radians(30.0)
_LOPSIDED = 0.25  # of a length, between left and right
SHORTEST_M, TALLEST_M = 1.2, 2.2
"""Nobody who operates is of another height; the trackers are wrong then [m]."""

_NO_TURN = [1.0, 0.0, 0.0, 0.0]
_SHARE_RANGE = (0.5, 1.8)  # of what an average person of that height has
_ARM_JOINTS = ("shoulder", "elbow", "wrist", "hand")


class NotCalibrated(StationError):
    """The operator could not be measured; one line that says what to do."""


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of an operator.

    Attributes:
        operator: Name.
        date: Day of the measurement, ``2026-11-21``.
        pose: What it was measured in; ``height`` when it was only told.
        height_m: How tall the operator is, from the lengths [m].
        lengths_m: Lengths of the body [m].
        heading_rad: Where the operator looked, in the device's world [rad].
        ankle_rest_z_m, ball_rest_z_m: Heights of ankles and balls of the feet, left and right, when both feet are flat
            on the floor, in the device's world [m].
        offsets_wxyz: By joint, the turn from the device's frame to the rest frame of the bone; none for one that is
            there already.
        device: What it was measured with; "" when it was not measured.
        source: Which one: its library, its service, or the script of a fake.
    """

    operator: str
    date: str = ""
    device: str = ""
    source: str = ""
    pose: Literal["t-pose", "standing", "height"]
    height_m: float
    lengths_m: Proportions
    heading_rad: float = 0.0
    ankle_rest_z_m: tuple[float, float]
    ball_rest_z_m: tuple[float, float]
    offsets_wxyz: dict[str, tuple[float, float, float, float]] = {}

    def turns(self) -> Floats:
        """Return the offsets of all joints as matrices, shape (24, 3, 3)."""
        quats = [self.offsets_wxyz.get(name, (1.0, 0.0, 0.0, 0.0)) for name in SMPL_24]
        unit = rotations.normalized(quats)
        return np.stack([rotations.rotate(unit, axis) for axis in np.eye(3)], axis=-1)


def from_height(height_m: float, operator: str = "") -> Calibration:
    """Return what to go by without a measurement: an average body, the floor at z = 0, frames that are rest frames."""
    return from_lengths(of_height(height_m), operator)


def from_lengths(lengths: Proportions, operator: str = "") -> Calibration:
    """Return what to go by when only the lengths are known."""
    ankle, ball = lengths.ankle_height, round(0.3 * lengths.ankle_height, 4)
    return Calibration(
        operator=operator, pose="height", height_m=round(lengths.height, 3), lengths_m=lengths,
        ankle_rest_z_m=(ankle, ankle), ball_rest_z_m=(ball, ball),
    )  # fmt: skip


def of_person(lengths: Proportions, operator: str = "") -> Calibration:
    """Return what a perfect device would measure of a person in a T-pose."""
    return calibrate([standing(lengths)] * LEAST_SAMPLES, operator)


def calibrate(
    bodies: Sequence[Body], operator: str, pose: Pose = "t-pose", *, device: str = "", source: str = ""
) -> Calibration:
    """Measure an operator who stands still.

    Args:
        bodies: About a second of samples, at least `LEAST_SAMPLES`.
        operator: Name.
        pose: ``t-pose``: arms straight out, palms down; ``standing``: arms hanging, palms to the thighs. Both upright,
            legs straight, feet flat and pointing forward.
        device, source: What the samples came from.

    Raises:
        NotCalibrated: too few samples, a body that is lost or moves, another pose, lengths that no person has.
    """
    positions, quats = _still(bodies)
    heading = _heading(positions)
    _check_pose(positions, heading, pose)
    lengths = _measured(positions)
    return Calibration(
        operator=operator,
        date=datetime.date.today().isoformat(),
        device=device,
        source=source,
        pose=pose,
        height_m=round(lengths.height, 3),
        lengths_m=lengths,
        heading_rad=round(heading, 4) + 0.0,
        ankle_rest_z_m=_pair(positions[[INDEX["left_ankle"], INDEX["right_ankle"]], 2]),
        ball_rest_z_m=_pair(positions[[INDEX["left_foot"], INDEX["right_foot"]], 2]),
        offsets_wxyz=_offsets(quats, heading, pose),
    )


def save(calibration: Calibration, path: Path) -> None:
    """Write a calibration as YAML.

    Raises:
        BadFile: the file cannot be written.
    """
    temporary = path.with_suffix(".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(
            _HEAD + yaml.safe_dump(msgspec.to_builtins(calibration), sort_keys=False), encoding="utf-8"
        )
        os.replace(temporary, path)
    except OSError as error:
        raise BadFile(f"{path}: cannot be written: {error.strerror}") from error


def load(path: Path) -> Calibration:
    """Read a calibration.

    Raises:
        BadFile: missing, or no calibration of an operator.
    """
    try:
        found = msgspec.yaml.decode(path.read_bytes(), type=Calibration)
    except OSError as error:
        raise BadFile(f"{path}: cannot be read: {error.strerror}; {MEASURE}") from error
    except (msgspec.MsgspecError, ValueError) as error:
        reason = " ".join(str(error).split())[:150]
        raise BadFile(f"{path}: not an operator's calibration ({reason}); {MEASURE}") from error
    _check_lengths(found.lengths_m, BadFile, f"{path}: ")
    return found


def _still(bodies: Sequence[Body]) -> tuple[Floats, Floats]:
    """Return median places, shape (24, 3), and mean orientations, shape (24, 4), of a body that stands still."""
    if len(bodies) < LEAST_SAMPLES:
        raise NotCalibrated(f"{len(bodies)} samples of the body, expected at least {LEAST_SAMPLES}; hold the pose")
    positions = np.array([body.positions for body in bodies])
    quats = np.array([body.quats_wxyz for body in bodies])
    if not (np.isfinite(positions).all() and np.isfinite(quats).all()):
        raise NotCalibrated("the body holds values that are not finite; is body tracking on and calibrated?")
    middle = np.median(positions, axis=0)
    if np.ptp(middle, axis=0).max() < 0.3 or (np.linalg.norm(quats, axis=-1) < 0.5).any():
        raise NotCalibrated("the body is lost: all joints are at one place; is body tracking on and calibrated?")
    off_m = np.linalg.norm(positions - middle, axis=-1).max(axis=0)
    worst = int(off_m.argmax())
    if off_m[worst] > STILL_M:
        raise NotCalibrated(
            f"{SMPL_24[worst]} moved by {off_m[worst]:.2f} m while it was measured, expected less than {STILL_M:g} m; "
            "stand still for a second"
        )
    signs = np.sign((quats * quats[:1]).sum(axis=-1, keepdims=True))
    return middle, rotations.normalized((quats * signs).sum(axis=0))


def _heading(positions: Floats) -> float:
    """Which way an operator faces [rad]: at right angles to hips and shoulders."""
    left = sum(positions[INDEX[f"left_{name}"]] - positions[INDEX[f"right_{name}"]] for name in ("hip", "shoulder"))
    return math.atan2(-left[0], left[1])


def _check_pose(positions: Floats, heading: float, pose: Pose) -> None:
    def towards(start: str, end: str) -> Floats:
        return np.asarray(positions[INDEX[end]] - positions[INDEX[start]])

    up, sideways = np.array([0.0, 0.0, 1.0]), np.array([-math.sin(heading), math.cos(heading), 0.0])
    lean = _angle(towards("pelvis", "neck"), up)
    if lean > _LEAN:
        raise NotCalibrated(f"the trunk leans by {math.degrees(lean):.0f}°, expected upright; stand straight")
    for sign, side in zip((1.0, -1.0), SIDES, strict=True):
        knee = _angle(towards(f"{side}_hip", f"{side}_knee"), towards(f"{side}_knee", f"{side}_ankle"))
        if knee > _BENT or _angle(towards(f"{side}_ankle", f"{side}_hip"), up) > _LEAN:
            raise NotCalibrated(f"the {side} leg is not straight below the hip; stand upright, feet below the hips")
        arm = towards(f"{side}_shoulder", f"{side}_wrist")
        wished, told = (sign * sideways, "straight out") if pose == "t-pose" else (-up, "hanging")
        off = _angle(arm, wished)
        if off > _ARM_OFF[pose]:
            raise NotCalibrated(
                f"the {side} arm is {math.degrees(off):.0f}° away from {told}; hold both arms {told} ({pose})"
            )


def _measured(positions: Floats) -> Proportions:
    def long(start: str, end: str) -> float:
        return float(np.linalg.norm(positions[INDEX[end]] - positions[INDEX[start]]))

    def both(start: str, end: str) -> float:
        left, right = (long(f"{side}_{start}", f"{side}_{end}") for side in SIDES)
        if abs(left - right) > _LOPSIDED * max(left, right):
            raise NotCalibrated(
                f"{start} to {end} is {left:.2f} m on the left and {right:.2f} m on the right; "
                "the body is tracked badly: calibrate the device's own trackers again"
            )
        return round((left + right) / 2.0, 4)

    hips, shoulders = (
        0.5 * (positions[INDEX[f"left_{name}"]] + positions[INDEX[f"right_{name}"]]) for name in ("hip", "shoulder")
    )
    ankle_z = positions[[INDEX["left_ankle"], INDEX["right_ankle"]], 2].mean()
    ball_z = positions[[INDEX["left_foot"], INDEX["right_foot"]], 2].mean()
    lengths = Proportions(
        thigh=both("hip", "knee"),
        shank=both("knee", "ankle"),
        ankle_height=round(max(float(ankle_z - ball_z) / 0.7, 0.02), 4),  # the ball is a third as high as the ankle
        foot=round(math.sqrt(max(both("ankle", "foot") ** 2 - float(ankle_z - ball_z) ** 2, 0.0)), 4),
        hip_half_width=round(long("left_hip", "right_hip") / 2.0, 4),
        hip_drop=round(float(positions[INDEX["pelvis"], 2] - hips[2]), 4),
        trunk=round(long("pelvis", "neck"), 4),
        shoulder_half_width=round(long("left_shoulder", "right_shoulder") / 2.0, 4),
        shoulder_drop=round(float(positions[INDEX["neck"], 2] - shoulders[2]), 4),
        upper_arm=both("shoulder", "elbow"),
        forearm=both("elbow", "wrist"),
        hand=both("wrist", "hand"),
        head=round(long("neck", "head"), 4),
    )
    _check_lengths(lengths, NotCalibrated, "")
    return lengths


def _check_lengths(lengths: Proportions, error: type[StationError], where: str) -> None:
    """Refuse lengths that no person has; those that only place a joint within the body may be anything."""
    if not SHORTEST_M <= lengths.height <= TALLEST_M:
        raise error(
            f"{where}the operator is {lengths.height:.2f} m tall, expected {SHORTEST_M} to {TALLEST_M} m; "
            "are headset and trackers calibrated, and worn where they belong?"
        )
    average = of_height(lengths.height)
    for name in ("thigh", "shank", "upper_arm", "forearm", "trunk"):
        length, usual = getattr(lengths, name), getattr(average, name)
        if not _SHARE_RANGE[0] * usual <= length <= _SHARE_RANGE[1] * usual:
            raise error(
                f"{where}{name} is {length:.2f} m, somebody of {lengths.height:.2f} m has about {usual:.2f} m; "
                "measure again"
            )


def _offsets(quats: Floats, heading: float, pose: Pose) -> dict[str, Any]:
    forward = rotations.from_rotation_vector(np.array([0.0, 0.0, heading]))
    known = np.tile(forward, (len(SMPL_24), 1))
    if pose == "standing":
        for side, sign in zip(SIDES, (-1.0, 1.0), strict=True):
            hanging = rotations.from_rotation_vector(np.array([sign * math.pi / 2, 0.0, 0.0]))
            rows = [INDEX[f"{side}_{joint}"] for joint in _ARM_JOINTS]
            known[rows] = rotations.multiply(forward, hanging)
    offsets = rotations.multiply(rotations.inverse(quats), known)
    offsets = np.round(offsets * np.where(offsets[:, :1] < 0.0, -1.0, 1.0), 5) + 0.0
    return {name: tuple(row) for name, row in zip(SMPL_24, offsets.tolist(), strict=True) if row != _NO_TURN}


def _pair(values: Floats) -> tuple[float, float]:
    return round(float(values[0]), 4), round(float(values[1]), 4)


def _angle(first: Floats, second: Floats) -> float:
    cosine = float(first @ second) / max(float(np.linalg.norm(first) * np.linalg.norm(second)), 1e-9)
    return math.acos(min(max(cosine, -1.0), 1.0))
