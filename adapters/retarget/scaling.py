"""The operator's posture in the robot's size: directions of bones are the operator's, lengths the robot's.

So every place that is asked for can be reached, whatever the operator's proportions. The path over the floor is scaled
by the length of the legs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from adapters.retarget.bone_frames import along_z, directed
from adapters.retarget.calibration import Calibration
from adapters.retarget.human import G1_SIZED, INDEX, SIDES, Proportions, knees
from adapters.retarget.skeleton import HAND_REST
from adapters.robots.g1 import kinematics
from station.operator.sample import Body
from station.protocols import Floats

STRAIGHTEST = 0.995
"""Of a straight leg's length, what the robot's legs are stretched to at most: knees that lock cannot push."""

LOWEST_M = 0.3
"""The pelvis is asked no lower [m]: no robot gets up from there."""

SEGMENTS = {
    "upper arm": ("upper_arm",),
    "forearm": ("forearm",),
    "hand to knuckles": ("hand",),
    "arm": ("upper_arm", "forearm", "hand"),
    "thigh": ("thigh",),
    "shank": ("shank",),
    "leg": ("thigh", "shank"),
    "ankle above floor": ("ankle_height",),
    "foot to ball": ("foot",),
    "trunk": ("trunk",),
    "neck to head": ("head",),
    "shoulders, across": ("shoulder_half_width",) * 2,
    "hips, across": ("hip_half_width",) * 2,
}
"""What a person calls the parts of a body, and the lengths that each is the sum of."""

_SOFT = 0.985  # from here on stretching is compressed, so that it ends without a jolt

_KNEE_BIAS = 0.1
_HIPS = np.array([[0.0, side * G1_SIZED.hip_half_width, -G1_SIZED.hip_drop] for side in (1, -1)])
_TURNS = ("pelvis", "spine3", "left_ankle", "right_ankle", "left_wrist", "right_wrist")


def _rows(*names: str) -> list[int]:
    return [INDEX[f"{side}_{name}"] for name in names for side in SIDES]


_HIP, _KNEE, _ANKLE, _BALL = (_rows(name) for name in ("hip", "knee", "ankle", "foot"))
_SHOULDER, _ELBOW, _WRIST = (_rows(name) for name in ("shoulder", "elbow", "wrist"))
_TURN_ROWS = [INDEX[name] for name in _TURNS]


@dataclass(frozen=True, slots=True, eq=False)
class LinkTargets:
    """What is asked of the robot's links, in the operator's world with the floor at z = 0.

    Attributes:
        pelvis: Place of its link, shape (3,) [m]; its height puts the lower foot onto the floor.
        pelvis_turn, chest_turn: Orientations of pelvis and torso_link, shape (3, 3).
        thighs: Directions from hip to knee, left and right, shape (2, 3).
        ankles: Places of the ankle_roll links, shape (2, 3) [m].
        feet_turn: Their orientations, shape (2, 3, 3).
        upper_arms, forearms: Directions to elbow and to wrist, shape (2, 3).
        hands_turn: Orientations of the wrist_yaw links, shape (2, 3, 3).
        soles: How high the operator's soles are above the floor of the calibration, in robot size, shape (2,) [m].
        steps: Where the operator's ankles are, in robot size, shape (2, 3) [m]; only their motion means something.
    """

    pelvis: Floats
    pelvis_turn: Floats
    chest_turn: Floats
    thighs: Floats
    ankles: Floats
    feet_turn: Floats
    upper_arms: Floats
    forearms: Floats
    hands_turn: Floats
    soles: Floats
    steps: Floats


class Segment(NamedTuple):
    """A part of a body, of the operator and of the robot [m]."""

    name: str
    operator_m: float
    robot_m: float

    @property
    def scale(self) -> float:
        """The robot's length over the operator's."""
        return self.robot_m / self.operator_m if self.operator_m > 0.0 else math.inf


def segments(lengths: Proportions) -> tuple[Segment, ...]:
    """Return the lengths of each part of an operator's body and of the robot's."""
    return tuple(
        Segment(name, _sum(lengths, parts), _sum(G1_SIZED, parts)) for name, parts in SEGMENTS.items()
    )  # fmt: skip


def _sum(lengths: Proportions, parts: tuple[str, ...]) -> float:
    return sum(float(getattr(lengths, part)) for part in parts)


class Scaler:
    """Takes an operator's body to what is asked of a G1.

    Args:
        calibration: Of this operator.
    """

    def __init__(self, calibration: Calibration) -> None:
        self.scale = G1_SIZED.leg / calibration.lengths_m.leg
        """Length of the robot's legs over the operator's; paths over the floor are that much shorter."""
        self._offsets = calibration.turns()[_TURN_ROWS]
        self._ankle_rest_z = np.array(calibration.ankle_rest_z_m)
        self._ball_rest_z = np.array(calibration.ball_rest_z_m)

    def step(self, body: Body) -> LinkTargets:
        """Return what is asked of the robot when the operator stands so."""
        at = body.positions
        turns = matrices(body.quats_wxyz[_TURN_ROWS]) @ self._offsets
        pelvis_turn, feet_turn = turns[0], turns[2:4]
        thighs, shanks = directed(at[_KNEE] - at[_HIP]), directed(at[_ANKLE] - at[_KNEE])
        legs = _not_locked(G1_SIZED.thigh * thighs + G1_SIZED.shank * shanks)
        ankles = _HIPS @ pelvis_turn.T + legs
        pelvis = np.empty(3)
        pelvis[:2] = self._pelvis_xy(at, pelvis_turn)
        pelvis[2] = max(-(ankles[:, 2] + _depth(feet_turn)).min(), LOWEST_M)
        soles = np.minimum(at[_ANKLE, 2] - self._ankle_rest_z, at[_BALL, 2] - self._ball_rest_z)
        return LinkTargets(
            pelvis=pelvis,
            pelvis_turn=pelvis_turn,
            chest_turn=turns[1],
            thighs=_thighs(legs, thighs, feet_turn[..., 0]),
            ankles=ankles + pelvis,
            feet_turn=feet_turn,
            upper_arms=directed(at[_ELBOW] - at[_SHOULDER]),
            forearms=directed(at[_WRIST] - at[_ELBOW]),
            hands_turn=turns[4:6] @ _HAND_LINKS,
            soles=soles * self.scale,
            steps=at[_ANKLE] * self.scale,
        )

    def _pelvis_xy(self, at: Floats, pelvis_turn: Floats) -> Floats:
        """The middle of the hips goes the operator's way; the robot's pelvis link is above it by its own measure."""
        hips = 0.5 * (at[_HIP[0]] + at[_HIP[1]]) * self.scale
        return np.asarray((hips + pelvis_turn @ (0.0, 0.0, G1_SIZED.hip_drop))[:2])


def matrices(quats_wxyz: Floats) -> Floats:
    """Return rotation matrices of unit quaternions, shape (..., 3, 3); faster for a few than one axis at a time."""
    w, x, y, z = quats_wxyz[..., 0], quats_wxyz[..., 1], quats_wxyz[..., 2], quats_wxyz[..., 3]
    out = np.empty((*quats_wxyz.shape[:-1], 3, 3))
    out[..., 0, 0], out[..., 1, 1], out[..., 2, 2] = (
        1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z), 1 - 2 * (x * x + y * y)
    )  # fmt: skip
    out[..., 0, 1], out[..., 1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    out[..., 0, 2], out[..., 2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    out[..., 1, 2], out[..., 2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    return out


def level(turns: Floats, share: Floats) -> Floats:
    """Return orientations (n, 3, 3) made level, each by a share (n,) from 0 (as it is) to 1 (only its heading)."""
    up = turns[..., 2] * (1.0 - share[:, None]) + np.array([0.0, 0.0, 1.0]) * share[:, None]
    return along_z(up, turns[..., 0])


def _depth(feet_turn: Floats) -> Floats:
    """Height of the lowest point of each sole against its ankle, shape (2,) [m]; negative."""
    return np.asarray((feet_turn[:, 2] @ kinematics.SOLE_POINTS.T).min(axis=1))


def _not_locked(legs: Floats) -> Floats:
    """Shorten what is stretched beyond `_SOFT`, shape (2, 3) [m]; a straight leg becomes `STRAIGHTEST`."""
    stretch = np.linalg.norm(legs, axis=1, keepdims=True) / G1_SIZED.leg
    wanted = _SOFT + (stretch - _SOFT) * (STRAIGHTEST - _SOFT) / (1.0 - _SOFT)
    return np.asarray(np.where(stretch > _SOFT, legs * (wanted / np.maximum(stretch, _SOFT)), legs))


def _thighs(legs: Floats, seen: Floats, forward: Floats) -> Floats:
    """Where the thighs point, shape (2, 3), when ankles are at `legs` from the hips and knees bend as the operator's.

    A straight leg says nothing of that; its knee bends to where the foot points.
    """
    knees_to = seen + _KNEE_BIAS * forward
    return directed(knees(np.zeros((2, 3)), legs, knees_to, G1_SIZED))


_HAND_LINKS = HAND_REST.swapaxes(-1, -2)
