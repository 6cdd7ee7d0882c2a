"""The command of a robot on legs that no network moves: absolute positions of its joints [rad]."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import ROBOTS
from station.arms import JointCommand
from station.protocols import Floats, Reference

BEYOND_RAD = 0.2
"""How far outside its range a target is still clamped [rad]; farther away it is another robot's, or a fault."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseCommand(JointCommand):
    """Positions of the joints on ``action_joints_<robot>``; without a command it goes back to how it stands."""

    holds_position: bool = False

    @classmethod
    def of(cls, robot: LeggedRobot) -> Self:
        """Return the format of a robot's commands."""
        lower, upper, speed = np.array(
            [(joint.lower, joint.upper, joint.velocity_rad_s) for joint in robot.joints]
        ).T  # fmt: skip
        command = cls.within(
            f"{robot.name.replace('_', '-')}-joints", robot.name, robot.joint_names, lower=lower, upper=upper,
            margin=np.full(len(lower), BEYOND_RAD), rate=speed,
        )  # fmt: skip
        stand = np.array(robot.start_q)
        stand.flags.writeable = False
        return replace(command, default=stand)

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return this robot's joints of a reference, shape (n,) [rad]; of one that lacks some, how the robot stands.

        A motion of another body is none of this one, not even where some of its joints have the same names.
        """
        wanted = [element.name.removesuffix("_pos") for element in self.elements]
        if not set(wanted) <= set(joint_names):
            return self.default.copy()
        return np.array([reference.q[joint_names.index(name)] for name in wanted])


GO2, GO1, H1, H1_2, G1_12, G1_23 = map(PoseCommand.of, ROBOTS.values())
