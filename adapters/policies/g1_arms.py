"""Legs of a G1 by a policy that follows velocities, arms by positions of their joints: a policy around another.

The one inside (`homie`, `groot-wbc`, `rlgym-g1`, `holosoma`) gets the velocities and sees the joints that it knows;
what it says of the arms is put aside. Joints that neither drives, the waist of a policy of legs, are held at zero.
Which policy walks with which arms was measured: docs/velocity.md.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adapters.commands.g1_parts import ARM, ARMS, arm
from adapters.commands.velocity import FORMATS
from adapters.policies.g1_whole import OnAllJoints
from adapters.policies.homie import HomiePolicy
from adapters.robots.g1.joints import G1_29
from station import registry
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, RobotState


class G1ArmsPolicy(OnAllJoints):
    """Implements `station.protocols.Policy`.

    Args:
        checkpoint: Of the policy inside.
        legs: Its registered name.
        legs_options: Its further arguments.

    Raises:
        UnknownName: it is not registered.
        ConfigError: it follows other commands than velocities, or drives joints that a G1 does not have.
        BadFile: as the policy inside says.
    """

    ORIGIN = f"the origin of the policy that its option `legs` names, for `homie` {HomiePolicy.ORIGIN}"

    def __init__(self, checkpoint: Path, *, legs: str = "homie", legs_options: dict[str, Any] | None = None) -> None:
        inside: Policy = registry.find("policy", legs)(checkpoint, **(legs_options or {}))
        given = inside.spec
        if given.command not in FORMATS:
            raise ConfigError(
                f"legs: policy {legs!r} follows {given.command!r} commands; expected one that follows "
                f"{', '.join(FORMATS)}"
            )
        super().__init__(inside, np.zeros(len(G1_29)), f"legs: policy {legs!r}")
        self._arms = [G1_29.index(name) for name in ARMS]
        self._count = len(given.command_lower if given.command_lower is not None else FORMATS[given.command].default)
        span = [
            (getattr(given, f"command_{end}"), [getattr(arm(side, ""), end) for side in ARM])
            for end in ("lower", "upper")
        ]
        lower, upper = (None if legs is None else np.concatenate([legs, *arms]) for legs, arms in span)
        self._spec = replace(
            self._spec, name="g1-arms", command=f"g1-arms-{given.command}", command_lower=lower, command_upper=upper
        )

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of the policy inside, of the velocities."""
        return super().observe(state, command[: self._count])

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy inside, and of the arms what the command says."""
        made = super().targets(action, command[: self._count])
        made.q[self._arms] = command[self._count :]
        return made
