"""What matters how much to the inverse kinematics of a body."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """What matters how much; costs of places are per metre, of directions and orientations per radian.

    Attributes:
        pelvis, pelvis_turn, chest_turn: Place and orientations of the trunk.
        foot, foot_turn: Of the ankle_roll links; the greatest, because feet that slide are what falls.
        thigh, upper_arm, forearm: Directions of bones, as places of their lower ends.
        hand_turn: Orientations of the hands.
        posture: Towards standing, for what nothing else decides: twists of straight arms.
        freeing: The same, of an arm that is led back (`arm_rescue`).
        damping: Against motion for its own sake.
    """

    pelvis: float = 10.0
    pelvis_turn: float = 6.0
    chest_turn: float = 4.0
    foot: float = 40.0
    foot_turn: float = 6.0
    thigh: float = 4.0
    upper_arm: float = 8.0
    forearm: float = 8.0
    hand_turn: float = 0.8
    posture: float = 0.02
    freeing: float = 2.0
    damping: float = 1e-4
