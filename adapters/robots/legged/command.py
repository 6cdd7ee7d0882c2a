"""The command of a robot on legs that no network moves: absolute positions of its joints [rad]."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import ROBOTS
from station.arms import JointCommand
from station.bus import keys
from station.protocols import Floats, Reference

BEYOND_RAD = 0.2
"""How far outside its range a target is still clamped [rad]; farther away it is another robot's, or a fault."""

PULL_RAD = 2.0
"""How far outside a joint's range a network may ask for it [rad]: 40 N m at the 20 N m/rad that a Go2's have, more than
a servo of it can do."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseCommand(JointCommand):
    """Positions of the joints on ``action_joints_<robot>``; without a command it goes back to how it stands.

    Attributes:
        follows_motions: As in `adapters.robots.legged.table.LeggedRobot`.
    """

    holds_position: bool = False
    follows_motions: bool = False

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
        return replace(command, default=stand, follows_motions=robot.follows_motions)

    @classmethod
    def of_network(cls, robot: LeggedRobot) -> Self:
        """Return the format of what a network elsewhere asks of a robot's joints, on ``action_targets_<robot>``.

        Such targets pull a soft servo: they lie beyond where a joint can go, and leap from step to step. What bounds
        them is the torque of the servo.
        """
        found = cls.of(robot)
        size = len(found.lower)
        pulled = cls.within(
            f"{robot.name.replace('_', '-')}-targets", robot.name, robot.joint_names, lower=found.lower - PULL_RAD,
            upper=found.upper + PULL_RAD, margin=np.zeros(size), rate=np.full(size, np.inf),
            stock_key=keys.action(f"targets_{robot.name}"),
        )  # fmt: skip
        return replace(pulled, default=found.default)

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return this robot's joints of a reference of its body, shape (n,) [rad]; of another's, how it stands.

        Raises:
            ConfigError: a reference of its body lacks a joint.
        """
        return JointCommand.encode(self, reference, joint_names) if self.follows_motions else self.default.copy()


GO2, GO1, H1, H1_10, H1_2, H1_2_12, G1_12, G1_23, G1_DEX3 = map(PoseCommand.of, ROBOTS.values())
GO2_TARGETS = PoseCommand.of_network(ROBOTS["go2"])
