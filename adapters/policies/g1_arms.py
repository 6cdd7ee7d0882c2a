"""Legs of a G1 by a policy that follows velocities, arms, and hands, by positions of their joints: around a policy.

The one inside (`homie`, `groot-wbc`, `rlgym-g1`, `holosoma`) gets the velocities and sees the joints that it knows;
what it says of the arms is put aside. Joints that neither drives, the waist of a policy of legs, are held at zero.
Which policy walks with which arms was measured: docs/velocity.md.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adapters.commands.g1_parts import ARM, arm, hand
from adapters.commands.velocity import FORMATS
from adapters.policies.g1_whole import OnAllJoints
from adapters.policies.homie import HomiePolicy
from adapters.robots.legged.unitree import G1, G1_DEX3
from station import registry
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, RobotState

_WITH_ARMS = "g1-arms-"


class G1ArmsPolicy(OnAllJoints):
    """Implements `station.protocols.Policy`.

    Args:
        checkpoint: Of the policy inside.
        legs: Its registered name.
        legs_options: Its further arguments.
        hands: Whether it drives the robot with Dex3-1 hands, whose joints are two parts more; the policy inside may
            then be one that takes the arms' commands as well (`asap`, `falcon`).

    Raises:
        UnknownName: it is not registered.
        ConfigError: it follows other commands than velocities, or drives joints that a G1 does not have.
        BadFile: as the policy inside says.
    """

    ORIGIN = f"the origin of the policy that its option `legs` names, for `homie` {HomiePolicy.ORIGIN}"

    def __init__(
        self, checkpoint: Path, *, legs: str = "homie", legs_options: dict[str, Any] | None = None, hands: bool = False
    ) -> None:
        inside: Policy = registry.find("policy", legs)(checkpoint, **(legs_options or {}))
        given = inside.spec
        velocities = given.command.removeprefix(_WITH_ARMS) if hands else given.command
        if velocities not in FORMATS:
            raise ConfigError(
                f"legs: policy {legs!r} follows {given.command!r} commands; expected one that follows "
                f"{', '.join(FORMATS)}{', or these with arms' if hands else ''}"
            )
        robot = G1_DEX3 if hands else G1
        super().__init__(inside, np.zeros(len(robot.joints)), f"legs: policy {legs!r}", robot)
        limbs = [make(side, "") for make in ((arm, hand) if hands else (arm,)) for side in ARM]
        taken = 0 if velocities == given.command else len(ARM)
        theirs, ours = limbs[:taken], limbs[taken:]
        self._limbs = [
            robot.joint_names.index(element.name.removesuffix("_pos")) for limb in ours for element in limb.elements
        ]
        self._count = len(FORMATS[velocities].default) + sum(len(limb.default) for limb in theirs)
        span = [(getattr(given, f"command_{end}"), [getattr(limb, end) for limb in ours]) for end in ("lower", "upper")]
        lower, upper = (None if inner is None else np.concatenate([inner, *ends]) for inner, ends in span)
        self._spec = replace(
            self._spec, name="g1-arms", command=f"g1-{'hands' if hands else 'arms'}-{velocities}",
            command_lower=lower, command_upper=upper,
        )  # fmt: skip

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of the policy inside, of its part of the command."""
        return super().observe(state, command[: self._count])

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy inside, and of arms and hands what the command says."""
        made = super().targets(action, command[: self._count])
        made.q[self._limbs] = command[self._count :]
        return made
