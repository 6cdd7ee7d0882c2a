"""Legs of a G1 by a policy elsewhere, which sends targets of their joints; one of ours stands while none come.

The policy inside, one that follows velocities, sees the robot in every step and is asked to stand. As far as the
command's share says, the targets that came are followed in its place, with the gains that HOMIE's ``g1_control`` has,
and the waist is held at zero as there. Arms do what their parts of the command say.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adapters.commands.g1_parts import ARMS
from adapters.commands.leg_targets import SHARE
from adapters.policies.g1_arms import G1ArmsPolicy
from adapters.policies.homie import HomiePolicy
from adapters.policies.walk.policy import G1WalkPolicy
from adapters.robots.g1.joints import LEGS, WAIST
from station import registry
from station.protocols import Floats, Floats32, JointTargets, RobotState

_BODY = len(LEGS) + len(WAIST)


class LegTargetsPolicy(G1ArmsPolicy):
    """Observation and action are those of the policy that stands.

    Args:
        checkpoint: Of the policy that stands.
        legs, legs_options: Its registered name and further arguments.

    Raises:
        UnknownName, ConfigError, BadFile: as `adapters.policies.g1_arms` says of it.
    """

    CHECKPOINT = G1WalkPolicy.CHECKPOINT

    def __init__(
        self, checkpoint: Path, *, legs: str = G1WalkPolicy.NAME, legs_options: dict[str, Any] | None = None
    ) -> None:
        super().__init__(checkpoint, legs=legs, legs_options=legs_options)
        self._stand: Floats = registry.find("command", self._spec.command).default[: -len(ARMS)]
        self._spec = replace(
            self._spec, name="g1-leg-targets", command="g1-arms-leg-targets", command_lower=None, command_upper=None
        )

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of the policy inside, which is to stand."""
        return super().observe(state, self._standing(command))

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy inside; as far as the share says, those that came."""
        made, share = super().targets(action, self._standing(command)), command[SHARE]
        asked = made.q.copy()
        asked[:SHARE], asked[SHARE:_BODY] = command[:SHARE], 0.0
        wanted = JointTargets(asked, *HomiePolicy.GAINS)
        q, kp, kd = (
            own + share * (theirs - own)
            for own, theirs in ((made.q, wanted.q), (made.kp, wanted.kp), (made.kd, wanted.kd))
        )
        return JointTargets(q, kp, kd)

    def _standing(self, command: Floats) -> Floats:
        """Return the command of the policy inside: no velocity, and the arms as they are commanded."""
        return np.concatenate([self._stand, command[SHARE + 1 :]])
