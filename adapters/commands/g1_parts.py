"""The command of a G1 whose parts are commanded apart: legs by velocities, arms and hands by positions of their joints.

| part | command | key, of the robot ``g1_29`` |
|---|---|---|
| ``legs`` | `velocity`, `velocity-height` or `velocity-posture` | ``action_<format>_g1_29_legs`` |
| | or what a policy elsewhere asks of them (`adapters.commands.leg_targets`) | ``action_targets_g1_29_legs`` |
| ``left_arm``, ``right_arm`` | 7 joint positions [rad] | ``action_joints_g1_29_left_arm``, ``…_right_arm`` |
| ``left_hand``, ``right_hand`` | 7 of a Dex3-1 [rad]; of the robot ``g1_dex3`` alone | ``…_left_hand``, … |
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from adapters.commands.hand import HandCommand, Side
from adapters.commands.leg_targets import LegTargets
from adapters.commands.velocity import FORMATS
from adapters.robots.g1 import joints as g1
from station.arms import JointCommand
from station.parts import PartedCommand
from station.protocols import CommandFormat, Floats, ForAnyRobot

FASTEST_RAD_S = 2.0
"""Arms that move faster under a policy that was not trained with moving arms throw it over (docs/velocity.md)."""

_BEYOND_RAD = 0.2  # outside its range a target is still clamped so far; farther away it is another arm's, or a fault

_SIDES: tuple[Side, ...] = ("left", "right")
ARM = {side: tuple(name for name in g1.G1_29[15:] if name.startswith(side)) for side in _SIDES}
"""The 7 joints of each arm, from the shoulder to the wrist."""

ARMS = ARM["left"] + ARM["right"]

HAND = {side: g1.hand(side) for side in ARM}
"""The 7 joints of each hand, in the order of its motors."""

HANDS = HAND["left"] + HAND["right"]

# A joint from open to closed, and what of a person's hand bends it. Source: amazon-far/TWIST2, parameters of the hands.
_CLOSED_RAD = {"thumb_0": 0.0, "thumb_1": 1.0, "thumb_2": 1.74, "middle_0": -1.57, "middle_1": -1.74, "index_0": -1.57,
               "index_1": -1.74}  # fmt: skip
_BENT_BY = {"thumb_0": "thumb_rotation", "thumb_1": "thumb_0", "thumb_2": "thumb_1"}


def arm(side: Side, robot: str) -> JointCommand:
    """Return the command of an arm of a robot."""
    names = ARM[side]
    return JointCommand.within(
        f"g1-{side}-arm", f"{robot}_{side}_arm", names, lower=g1.lower(names), upper=g1.upper(names),
        margin=np.full(len(names), _BEYOND_RAD), rate=np.minimum(g1.velocity(names), FASTEST_RAD_S),
    )  # fmt: skip


def hand(side: Side, robot: str, *, name: str = "", stock_key: str = "") -> HandCommand:
    """Return the command of a Dex3-1 hand of a robot; the right one's joints turn the other way.

    Args:
        side: Which.
        robot: The robot's.
        name: Registered name; "" for ``g1-SIDE-hand``.
        stock_key: Bus key that stock programs write it on; "" for the station's own.
    """
    names = HAND[side]
    short = [name.removeprefix(f"{side}_hand_") for name in names]
    closed = np.array([_CLOSED_RAD[name] for name in short]) * (1.0 if side == "left" else -1.0) + 0.0  # no minus zero
    opened = np.zeros(len(names))
    for array in (opened, closed):
        array.flags.writeable = False
    bare = JointCommand.within(
        name or f"g1-{side}-hand", f"{robot}_{side}_hand", names, lower=g1.lower(names), upper=g1.upper(names),
        margin=np.full(len(names), _BEYOND_RAD), rate=g1.velocity(names), stock_key=stock_key,
        awaits_pause=not stock_key,
    )  # fmt: skip
    return HandCommand(
        **{field.name: getattr(bare, field.name) for field in fields(bare)},
        side=side, fingers=tuple(_BENT_BY.get(each, each) for each in short), opened=opened, closed=closed,
    )  # fmt: skip


class LegsAndArms(PartedCommand):
    """As `PartedCommand`; the legs' range is that of their policy (`station.protocols.ForAnyRobot`).

    Args:
        legs: The velocities, or the targets of a policy elsewhere.
        robot: Suffix of the robot's keys; "" for any.
        lower, upper: Range of each element, shape (m,), of which that of the legs counts; None for its own.
        hands: Whether both hands are parts as well.
    """

    def __init__(
        self, legs: ForAnyRobot, robot: str = "", lower: Floats | None = None, upper: Floats | None = None, *,
        hands: bool = False,
    ) -> None:  # fmt: skip
        count = len(ARMS) + (len(HANDS) if hands else 0)
        bound: CommandFormat = legs.for_robot(
            f"{robot}_legs", None if lower is None else lower[:-count], None if upper is None else upper[:-count]
        )
        limbs = [make(side, robot) for make in ((arm, hand) if hands else (arm,)) for side in ARM]
        name = bound.name.removeprefix("g1-")
        super().__init__(f"g1-{'hands' if hands else 'arms'}-{name}", robot, (bound, *limbs))
        self._legs, self._hands = legs, hands

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return the format of a robot, within a range of shape (m,)."""
        return LegsAndArms(self._legs, robot, lower, upper, hands=self._hands)


VELOCITY, VELOCITY_HEIGHT, VELOCITY_POSTURE = (LegsAndArms(each) for each in FORMATS.values())
HANDS_VELOCITY, HANDS_VELOCITY_HEIGHT, HANDS_VELOCITY_POSTURE = (
    LegsAndArms(each, hands=True) for each in FORMATS.values()
)
LEG_TARGETS = LegsAndArms(LegTargets())
LEFT_ARM, RIGHT_ARM = (arm(side, "g1_29") for side in ARM)
"""Of the simulated G1, for the driver `arm-joints`."""
LEFT_HAND, RIGHT_HAND = (hand(side, "g1_dex3") for side in HAND)
"""Of the simulated G1 with hands, for the driver `fingers`."""
