"""The command of an arm: absolute positions of its joints, 7 numbers [rad] on ``action_joints_<robot>``.

An arm has no standing to go back to: without a command it stays where it is (`CommandFormat.holds_position`), and
`default` only tells the length of the vector and a place within its range.
"""

from __future__ import annotations

import math

import numpy as np

from adapters.robots.arm_limits import SOFT_MARGIN_RAD, ArmLimits
from station.arms import JointCommand

BEYOND_RAD = 0.2
"""How far outside the soft limits a target is still clamped [rad]; farther away it is another arm's, or a fault."""


def arm_command(maker: str, limits: ArmLimits, *, speed_rad_s: float = math.inf, robot: str = "") -> JointCommand:
    """Return the format of an arm's commands.

    Args:
        maker: First half of the suffix of the robot's keys, for example ``kassow``.
        limits: Of its joints; commands end `SOFT_MARGIN_RAD` inside them.
        speed_rad_s: Greatest change of a target per second, where it is below the joint's own.
        robot: Another suffix of its keys; "" for ``<maker>_<model>``.
    """
    lower, upper = limits.q_min + SOFT_MARGIN_RAD, limits.q_max - SOFT_MARGIN_RAD
    return JointCommand.within(
        maker,
        robot or f"{maker}_{limits.model}",
        limits.joint_names,
        lower=lower,
        upper=upper,
        margin=np.full(len(lower), BEYOND_RAD),
        rate=np.minimum(limits.qd_max, speed_rad_s),
    )
