"""A captured person in our world: x forward, y left, z up [m], the floor at zero, looking along x in the first frame.

What a file does not say is told by the person: which way is up by where the head is, the unit by how tall the person
is, the floor by the lowest places of the feet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np

from adapters.captures import geometry
from adapters.captures.joints import PLACES, Joints
from adapters.retarget.anchor import heading
from adapters.retarget.bone_frames import along_z, to_quats
from adapters.retarget.calibration import SHORTEST_M, TALLEST_M, Calibration, from_lengths
from adapters.retarget.human import INDEX, SIDES, Proportions, of_height
from adapters.retarget.skeleton_file import Skeletons
from station import rotations
from station.bus.joints import SMPL_24
from station.errors import BadFile
from station.protocols import Floats
from station.retargeting import Unit

UNITS_M: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45}
"""Length of each unit [m]; CMU's files have a unit of 1/0.45 inch."""

assert set(UNITS_M) == set(get_args(Unit))

_LOW = 0.05  # part of the frames in which a foot is lower: the floor, but for what one bad frame says
_Put = Callable[[str, Floats, Floats], None]
_SPINE = ("spine1", "spine2", "spine3")


@dataclass(frozen=True, slots=True, eq=False)
class Captured:
    """A captured person.

    Attributes:
        path: The file.
        person: The motion; orientations are those of bones against a T-pose.
        calibration: Lengths of the person, and how high ankles and balls of the feet are when they stand flat.
        fps: Frames per second of the file.
        unit: What a length of 1 in the file is, in words.
        notes: What was guessed, filled or left out, for the user.
    """

    path: Path
    person: Skeletons
    calibration: Calibration
    fps: float
    unit: str
    notes: tuple[str, ...]


def placed(joints: Joints, *, units: Unit | None = None, height_m: float | None = None) -> Captured:
    """Put a person into our world.

    Args:
        joints: As a reader found them.
        units: Of the file, in place of what it says, or of a guess.
        height_m: How tall the person is [m]: the file is scaled so.

    Raises:
        BadFile: no person, left and right are exchanged, or no unit makes a person of it.
    """
    places, turns, up = _upright(joints)
    lengths = _lengths(places)
    if lengths.leg <= 0.0:
        raise BadFile(f"{joints.path}: all joints are at one place; expected a person")
    scale, unit, notes = _scale(joints, lengths.height, units, height_m)
    places = {name: place * scale for name, place in places.items()}
    lengths = _lengths(places)
    places, turns = _from_origin(places, turns)
    rest_z = _rest_heights(places, lengths)
    person = Skeletons(*bodies(places, turns), np.arange(len(places["head"])) / joints.fps, round(lengths.height, 3))
    ankle, ball = (round(float(rest_z[name]), 4) for name in ("ankle", "ball"))
    known = msgspec.structs.replace(
        from_lengths(lengths), ankle_rest_z_m=(ankle, ankle), ball_rest_z_m=(ball, ball)
    )  # fmt: skip
    sideways = () if up == "z" else (f"{up} is up",)
    return Captured(joints.path, person, known, joints.fps, unit, (*joints.notes, *notes, *sideways))


def _upright(joints: Joints) -> tuple[dict[str, Floats], dict[str, Floats], str]:
    """Turn the file's world so that z is up; return places and orientations there, and what was up in the file."""
    at = joints.places
    up = geometry.axis_up(at["head"], 0.5 * (at["left_ankle"] + at["right_ankle"]))
    axis = int(np.abs(up).argmax())
    sign = float(up[axis])
    world = np.roll(np.eye(3), axis - 2, axis=1)
    world = world if sign > 0 else np.diag([1.0, -1.0, -1.0]) @ world
    places = {name: place @ world.T for name, place in at.items()}
    left = places["left_hip"] - places["right_hip"]
    forward = np.sum([places[f"{side}_ball"] - places[f"{side}_ankle"] for side in SIDES], axis=0)
    if float((left[:, 0] * forward[:, 1] - left[:, 1] * forward[:, 0]).mean()) > 0.0:
        raise BadFile(
            f"{joints.path}: toes point backward by what left and right say; are sides exchanged, or axes left-handed?"
        )
    return places, {name: world @ turn for name, turn in joints.turns.items()}, "-" * (sign < 0) + "xyz"[axis]


def _lengths(places: dict[str, Floats]) -> Proportions:
    """Return a person's lengths, medians over all frames, in the unit of the places."""

    def long(start: str, end: str) -> float:
        return float(np.median(np.linalg.norm(places[end] - places[start], axis=1)))

    def both(start: str, end: str) -> float:
        return 0.5 * sum(long(f"{side}_{start}", f"{side}_{end}") for side in SIDES)

    hips, shoulders = (0.5 * (places[f"left_{name}"] + places[f"right_{name}"]) for name in ("hip", "shoulder"))
    to_neck = float(np.median(np.linalg.norm(places["neck"] - hips, axis=1)))
    shares = of_height(1.0)  # what joints do not tell: where in a pelvis its middle is, how thick a foot is
    leg = both("hip", "knee") + both("knee", "ankle")
    tall = leg / shares.leg
    return Proportions(
        thigh=both("hip", "knee"), shank=both("knee", "ankle"), ankle_height=shares.ankle_height * tall,
        foot=both("ankle", "ball"), hip_half_width=0.5 * long("left_hip", "right_hip"),
        hip_drop=shares.hip_drop * tall, trunk=to_neck - shares.hip_drop * tall,
        shoulder_half_width=0.5 * long("left_shoulder", "right_shoulder"),
        shoulder_drop=float(np.median(np.linalg.norm(places["neck"] - shoulders, axis=1))),
        upper_arm=both("shoulder", "elbow"), forearm=both("elbow", "wrist"), hand=shares.hand * tall,
        head=long("neck", "head"),
    )  # fmt: skip


def _scale(
    joints: Joints, tall: float, units: Unit | None, height_m: float | None
) -> tuple[float, str, tuple[str, ...]]:
    """Return what a length of the file is multiplied by, that in words, and what to tell of it."""
    if height_m is not None and joints.height_m is None:
        return height_m / tall, f"scaled to {height_m:g} m", ()
    if units is not None and joints.height_m is None:
        unit_m, unit, told = UNITS_M[units], units, ""
    elif joints.unit_m is not None:
        unit_m, told = joints.unit_m, ""
        unit = next(name for name, size in UNITS_M.items() if size == unit_m)
    else:
        fitting = [name for name, size in UNITS_M.items() if SHORTEST_M <= tall * size <= TALLEST_M]
        if not fitting:
            raise BadFile(
                f"{joints.path}: the skeleton is {tall:.4g} tall; no unit of {', '.join(UNITS_M)} makes "
                f"{SHORTEST_M:g} to {TALLEST_M:g} m of it; say how tall the person is with --height"
            )
        unit, unit_m = fitting[0], UNITS_M[fitting[0]]
        told = (
            f"lengths taken for {unit}: the person is {tall * unit_m:.2f} m tall then; --units or --height says better"
        )
    if not SHORTEST_M <= tall * unit_m <= TALLEST_M:
        raise BadFile(
            f"{joints.path}: the person is {tall * unit_m:.4g} m tall in {unit}, expected {SHORTEST_M:g} to "
            f"{TALLEST_M:g} m; another unit (--units), or --height"
        )
    return unit_m, unit, (told,) if told else ()


def _from_origin(places: dict[str, Floats], turns: dict[str, Floats]) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Let the person begin at the origin and look along x; the world turns about the vertical alone."""
    yaw = heading(to_quats(turns["pelvis"][0]))
    turn = rotations.from_rotation_vector(np.array([0.0, 0.0, -yaw]))
    world = np.stack([rotations.rotate(turn, axis) for axis in np.eye(3)], axis=-1)
    begin = 0.5 * (places["left_hip"][0] + places["right_hip"][0]) * (1.0, 1.0, 0.0)
    return (
        {name: (place - begin) @ world.T for name, place in places.items()},
        {name: world @ each for name, each in turns.items()},
    )


def _rest_heights(places: dict[str, Floats], lengths: Proportions) -> dict[str, float]:
    """Put the floor below the feet, in place; return how high ankles and balls are when a foot stands flat [m]."""
    low = {
        name: float(np.quantile(np.concatenate([places[f"{side}_{name}"][:, 2] for side in SIDES]), _LOW))
        for name in ("ankle", "ball")
    }
    floor = low["ankle"] - lengths.ankle_height
    for name in PLACES:
        places[name] = places[name] - (0.0, 0.0, floor)
    return {name: height - floor for name, height in low.items()}


def bodies(places: Mapping[str, Floats], turns: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    """Return positions (n, 24, 3) [m] and orientations (n, 24, 4) of the joints of a tracked body.

    Args:
        places: As `adapters.captures.joints.Joints` has them, in our world [m].
        turns: As it has them, in our world; and that of the ``head`` where it is known, else the chest's counts.
    """
    count = len(places["head"])
    at, frames = np.empty((count, len(SMPL_24), 3)), np.empty((count, len(SMPL_24), 3, 3))

    def put(name: str, place: Floats, turn: Floats) -> None:
        at[:, INDEX[name]], frames[:, INDEX[name]] = place, turn

    pelvis, chest = turns["pelvis"], turns["chest"]
    hips = 0.5 * (places["left_hip"] + places["right_hip"])
    put("pelvis", hips, pelvis)
    for number, name in enumerate(_SPINE, start=1):
        put(name, hips + (places["neck"] - hips) * (number / 4), chest)
    put("neck", places["neck"], chest)
    put("head", places["head"], turns.get("head", chest))
    for side in SIDES:
        _put_limbs(put, side, places, turns)
    return at, to_quats(frames)


def _put_limbs(put: _Put, side: str, places: Mapping[str, Floats], turns: Mapping[str, Floats]) -> None:
    foot, hand, chest = turns[f"{side}_foot"], turns[f"{side}_hand"], turns["chest"]
    hip, knee, ankle = (places[f"{side}_{name}"] for name in ("hip", "knee", "ankle"))
    put(f"{side}_hip", hip, along_z(hip - knee, foot[..., 0]))
    put(f"{side}_knee", knee, along_z(knee - ankle, foot[..., 0]))
    put(f"{side}_ankle", ankle, foot)
    put(f"{side}_foot", places[f"{side}_ball"], foot)
    shoulder, elbow, wrist = (places[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
    put(f"{side}_collar", 0.75 * places["neck"] + 0.25 * shoulder, chest)
    put(f"{side}_shoulder", shoulder, chest)
    put(f"{side}_elbow", elbow, hand)
    put(f"{side}_wrist", wrist, hand)
    put(f"{side}_hand", 1.3 * wrist - 0.3 * elbow, hand)  # knuckles, about; nothing is asked of their place
