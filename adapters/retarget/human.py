"""A person's proportions, and the 24 joints of a body put together from how its bones point.

Shares of the height are rounded from Winter, *Biomechanics and Motor Control of Human Movement*, table 4.1 (after
Drillis and Contini, 1964); those of the trunk from what SMPL's mean body has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from adapters.retarget.bone_frames import along_z, directed, to_quats
from station import rotations
from station.bus.joints import SMPL_24
from station.operator.sample import Body
from station.protocols import Floats

SIDES = ("left", "right")
INDEX = {name: index for index, name in enumerate(SMPL_24)}
"""Place of a joint in a `station.operator.sample.Body`."""

OUT = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
"""Where an arm points in its rest frame, left and right, shape (2, 3)."""

_Put = Callable[[str, Floats, Floats], None]

_SPINE = (0.14, 0.40, 0.65, 1.0)  # where spine1, spine2, spine3 and neck are, from the pelvis up


@dataclass(frozen=True, slots=True, kw_only=True)
class Proportions:
    """Lengths of a body [m].

    Attributes:
        thigh, shank: Hip to knee, knee to ankle.
        ankle_height: Ankle above the floor when the foot is flat.
        foot: Ankle to the ball of the foot, along the floor.
        hip_half_width: Middle of the body to a hip.
        hip_drop: Pelvis joint above the hips.
        trunk: Pelvis joint to neck.
        shoulder_half_width: Middle of the body to a shoulder.
        shoulder_drop: Neck above the shoulders.
        upper_arm, forearm, hand: Shoulder to elbow, to wrist, to the knuckles.
        head: Neck to head joint.
    """

    thigh: float
    shank: float
    ankle_height: float
    foot: float
    hip_half_width: float
    hip_drop: float
    trunk: float
    shoulder_half_width: float
    shoulder_drop: float
    upper_arm: float
    forearm: float
    hand: float
    head: float

    @property
    def leg(self) -> float:
        """Hip to ankle of a straight leg [m]."""
        return self.thigh + self.shank

    @property
    def height(self) -> float:
        """How tall a person of these lengths is, about [m]."""
        return (self.ankle_height + self.leg + self.hip_drop + self.trunk + self.head) / _TO_HEAD_JOINT


_SHARES = Proportions(
    thigh=0.245, shank=0.246, ankle_height=0.039, foot=0.085, hip_half_width=0.05, hip_drop=0.05, trunk=0.285,
    shoulder_half_width=0.11, shoulder_drop=0.045, upper_arm=0.160, forearm=0.146, hand=0.055, head=0.065,
)  # fmt: skip
_TO_HEAD_JOINT = _SHARES.ankle_height + _SHARES.thigh + _SHARES.shank + _SHARES.hip_drop + _SHARES.trunk + _SHARES.head

G1_SIZED = Proportions(
    thigh=0.3366, shank=0.3176, ankle_height=0.035, foot=0.12, hip_half_width=0.1185, hip_drop=0.1027, trunk=0.314,
    shoulder_half_width=0.1406, shoulder_drop=0.025, upper_arm=0.1846, forearm=0.1384, hand=0.10, head=0.13,
)  # fmt: skip
"""A person as large as a G1, from its link table: hips on the axes of hip pitch, wrists on those of wrist pitch."""


def of_height(height_m: float) -> Proportions:
    """Return the lengths of an average adult of a height [m]."""
    shares = {field.name: getattr(_SHARES, field.name) for field in fields(Proportions)}
    return Proportions(**{name: round(share * height_m, 4) for name, share in shares.items()})


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """How the bones of a body point, n frames; rotation matrices from rest frame to world.

    Attributes:
        pelvis: Middle between the hips, shape (n, 3) [m].
        pelvis_turn, chest_turn: Shape (n, 3, 3).
        ankles: Shape (2, n, 3) [m].
        feet_turn: Shape (2, n, 3, 3).
        knees_to: Where the knees bend to, shape (2, n, 3).
        upper_arms_turn, forearms_turn, hands_turn: Shape (2, n, 3, 3) each.
    """

    pelvis: Floats
    pelvis_turn: Floats
    chest_turn: Floats
    ankles: Floats
    feet_turn: Floats
    knees_to: Floats
    upper_arms_turn: Floats
    forearms_turn: Floats
    hands_turn: Floats


def assembled(posture: Posture, lengths: Proportions) -> tuple[Floats, Floats]:
    """Return positions (n, 24, 3) [m] and orientations (n, 24, 4) of the joints of a body."""
    count = len(posture.pelvis)
    positions, turns = np.empty((count, len(SMPL_24), 3)), np.empty((count, len(SMPL_24), 3, 3))

    def put(name: str, position: Floats, turn: Floats) -> None:
        positions[:, INDEX[name]], turns[:, INDEX[name]] = position, turn

    pelvis = posture.pelvis + posture.pelvis_turn @ (0.0, 0.0, lengths.hip_drop)
    put("pelvis", pelvis, posture.pelvis_turn)
    neck = _put_spine(put, pelvis, posture, lengths)
    for side, name in enumerate(SIDES):
        outward = OUT[side]
        hip = posture.pelvis + posture.pelvis_turn @ (outward * lengths.hip_half_width)
        _put_leg(put, name, hip, (posture.ankles[side], posture.feet_turn[side], posture.knees_to[side]), lengths)
        shoulder = neck + posture.chest_turn @ (
            outward * lengths.shoulder_half_width - (0.0, 0.0, lengths.shoulder_drop)
        )
        put(f"{name}_collar", 0.75 * neck + 0.25 * shoulder, posture.chest_turn)
        put(f"{name}_shoulder", shoulder, posture.upper_arms_turn[side])
        elbow = shoulder + posture.upper_arms_turn[side] @ (outward * lengths.upper_arm)
        put(f"{name}_elbow", elbow, posture.forearms_turn[side])
        wrist = elbow + posture.forearms_turn[side] @ (outward * lengths.forearm)
        put(f"{name}_wrist", wrist, posture.hands_turn[side])
        put(f"{name}_hand", wrist + posture.hands_turn[side] @ (outward * lengths.hand), posture.hands_turn[side])
    return positions, to_quats(turns)


def _put_spine(put: _Put, pelvis: Floats, posture: Posture, lengths: Proportions) -> Floats:
    """Bend the spine by thirds from the pelvis to the chest; return where the neck is."""
    low, high = to_quats(posture.pelvis_turn), to_quats(posture.chest_turn)
    at, below = pelvis + posture.pelvis_turn @ (0.0, 0.0, _SPINE[0] * lengths.trunk), _SPINE[0]
    for number, above in enumerate(_SPINE[1:], start=1):
        turn = _matrices(rotations.slerp(low, high, np.full(len(low), number / 3)))
        put(f"spine{number}", at, turn)
        at, below = at + turn @ (0.0, 0.0, (above - below) * lengths.trunk), above
    put("neck", at, posture.chest_turn)
    put("head", at + posture.chest_turn @ (0.0, 0.0, lengths.head), posture.chest_turn)
    return np.asarray(at)


def _put_leg(put: _Put, name: str, hip: Floats, end: tuple[Floats, Floats, Floats], lengths: Proportions) -> None:
    ankle, foot_turn, knee_to = end
    knee = knees(hip, ankle, knee_to, lengths)
    put(f"{name}_hip", hip, along_z(hip - knee, knee_to))
    put(f"{name}_knee", knee, along_z(knee - ankle, knee_to))
    put(f"{name}_ankle", ankle, foot_turn)
    ball = ankle + foot_turn @ (lengths.foot, 0.0, -0.7 * lengths.ankle_height)
    put(f"{name}_foot", ball, foot_turn)


def knees(hip: Floats, ankle: Floats, knee_to: Floats, lengths: Proportions) -> Floats:
    """Return where the knees are, shape (n, 3) [m]; a leg that cannot reach is straight, its bones drawn out."""
    reach = ankle - hip
    distance = np.linalg.norm(reach, axis=-1)
    along = directed(reach)
    # Law of cosines: how far down the line from hip to ankle the knee is, and how far beside it.
    down = (lengths.thigh**2 - lengths.shank**2 + distance**2) / (2.0 * np.maximum(distance, 1e-6))
    down = np.where(distance >= lengths.leg, lengths.thigh * distance / lengths.leg, down)
    beside = np.sqrt(np.maximum(lengths.thigh**2 - down**2, 0.0))
    beside = np.where(distance >= lengths.leg, 0.0, beside)
    forward = directed(knee_to - along * (knee_to * along).sum(axis=-1, keepdims=True))
    return np.asarray(hip + along * down[:, None] + forward * beside[:, None])


def standing(
    lengths: Proportions,
    *,
    arms: Literal["out", "down"] = "out",
    heading_rad: float = 0.0,
    at: tuple[float, float] = (0.0, 0.0),
) -> Body:
    """Return the body of a person who stands upright on the floor, arms out (a T-pose) or hanging."""
    turn = _matrices(rotations.from_rotation_vector(np.array([[0.0, 0.0, heading_rad]])))
    pelvis = np.array([[*at, lengths.ankle_height + lengths.leg]])
    feet = np.stack([pelvis + turn @ (out * lengths.hip_half_width) for out in OUT])
    feet[..., 2] = lengths.ankle_height
    both = np.stack([turn, turn])
    arms_turn = both if arms == "out" else np.stack([turn @ HANGING[side] for side in range(2)])
    posture = Posture(
        pelvis=pelvis, pelvis_turn=turn, chest_turn=turn, ankles=feet, feet_turn=both, knees_to=both[..., 0],
        upper_arms_turn=arms_turn, forearms_turn=arms_turn, hands_turn=arms_turn,
    )  # fmt: skip
    positions, quats = assembled(posture, lengths)
    return Body(positions[0], quats[0])


def _matrices(quats: Floats) -> Floats:
    return np.stack([rotations.rotate(quats, axis) for axis in np.eye(3)], axis=-1)


HANGING = np.stack(
    [_matrices(rotations.from_rotation_vector(np.array([turn, 0.0, 0.0]))) for turn in (-np.pi / 2, np.pi / 2)]
)
"""Turn of a hanging arm's bones against their rest frames, palms to the thighs, left and right, shape (2, 3, 3)."""
