"""The command of a G1 whose legs and arms are commanded apart: legs by velocities, each arm by positions of its joints.

| part | command | key, of the robot ``g1_29`` |
|---|---|---|
| ``legs`` | `velocity`, `velocity-height` or `velocity-posture` | ``action_<format>_g1_29_legs`` |
| ``left_arm``, ``right_arm`` | 7 joint positions [rad] | ``action_joints_g1_29_left_arm``, ``…_right_arm`` |
"""

from __future__ import annotations

import numpy as np

from adapters.commands.velocity import FORMATS
from adapters.robots.g1 import joints as g1
from station.arms import JointCommand
from station.parts import PartedCommand
from station.protocols import CommandFormat, Floats, ForAnyRobot

FASTEST_RAD_S = 2.0
"""Arms that move faster under a policy that was not trained with moving arms throw it over (docs/velocity.md)."""

_BEYOND_RAD = 0.2  # outside its range a target is still clamped so far; farther away it is another arm's, or a fault

ARM = {side: tuple(name for name in g1.G1_29[15:] if name.startswith(side)) for side in ("left", "right")}
"""The 7 joints of each arm, from the shoulder to the wrist."""

ARMS = ARM["left"] + ARM["right"]


def arm(side: str, robot: str) -> JointCommand:
    """Return the command of an arm of a robot."""
    names = ARM[side]
    return JointCommand.within(
        f"g1-{side}-arm", f"{robot}_{side}_arm", names, lower=g1.lower(names), upper=g1.upper(names),
        margin=np.full(len(names), _BEYOND_RAD), rate=np.minimum(g1.velocity(names), FASTEST_RAD_S),
    )  # fmt: skip


class LegsAndArms(PartedCommand):
    """As `PartedCommand`; the legs' range is that of their policy (`station.protocols.ForAnyRobot`).

    Args:
        legs: The velocities.
        robot: Suffix of the robot's keys; "" for any.
        lower, upper: Range of each element, shape (m,), of which that of the legs counts; None for its own.
    """

    def __init__(
        self, legs: ForAnyRobot, robot: str = "", lower: Floats | None = None, upper: Floats | None = None
    ) -> None:
        count = len(ARMS)
        bound: CommandFormat = legs.for_robot(
            f"{robot}_legs", None if lower is None else lower[:-count], None if upper is None else upper[:-count]
        )
        super().__init__(f"g1-arms-{bound.name}", robot, (bound, arm("left", robot), arm("right", robot)))
        self._legs = legs

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return the format of a robot, within a range of shape (m,)."""
        return LegsAndArms(self._legs, robot, lower, upper)


VELOCITY, VELOCITY_HEIGHT, VELOCITY_POSTURE = (LegsAndArms(each) for each in FORMATS.values())
LEFT_ARM, RIGHT_ARM = (arm(side, "g1_29") for side in ARM)
"""Of the simulated G1, for the driver `arm-joints`."""
