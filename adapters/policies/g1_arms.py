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
from adapters.policies.groot_wbc import GrootWbcPolicy
from adapters.policies.homie import HomiePolicy
from adapters.robots.g1.joints import G1_29
from station import registry
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, PolicySpec, RobotState

_WAIST = 400.0, 20.0
"""Stiffness and damping of a waist that no policy drives [N m/rad, N m s/rad]. Measured under `rlgym-g1`, on our model:
at 250 and 5 the trunk shakes by 1.4 rad/s against the legs, at these by 0.1."""


class G1ArmsPolicy:
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
        self._legs: Policy = registry.find("policy", legs)(checkpoint, **(legs_options or {}))
        inside: PolicySpec = self._legs.spec
        if inside.command not in FORMATS:
            raise ConfigError(
                f"legs: policy {legs!r} follows {inside.command!r} commands; expected one that follows "
                f"{', '.join(FORMATS)}"
            )
        odd = [name for name in inside.joint_names if name not in G1_29]
        if odd:
            raise ConfigError(f"legs: policy {legs!r} drives another robot: a G1 has no joint {', '.join(odd[:4])}")
        self._known = [G1_29.index(name) for name in inside.joint_names]
        self._arms = [G1_29.index(name) for name in ARMS]
        self._count = len(inside.command_lower if inside.command_lower is not None else FORMATS[inside.command].default)
        default, (kp, kd) = np.zeros(len(G1_29)), (gains.copy() for gains in GrootWbcPolicy.GAINS)
        kp[12:15], kd[12:15] = _WAIST
        for whole, given in ((default, inside.default_q), (kp, inside.kp), (kd, inside.kd)):
            whole[self._known] = given
        span = [
            (getattr(inside, f"command_{end}"), [getattr(arm(side, ""), end) for side in ARM])
            for end in ("lower", "upper")
        ]
        lower, upper = (None if legs is None else np.concatenate([legs, *arms]) for legs, arms in span)
        self._spec: PolicySpec = replace(
            inside, name="g1-arms", command=f"g1-arms-{inside.command}", joint_names=G1_29, default_q=default,
            kp=kp, kd=kd, command_lower=lower, command_upper=upper,
        )  # fmt: skip

    @property
    def spec(self) -> PolicySpec:
        """The constants of the policy inside, for all joints of a G1."""
        return self._spec

    def reset(self) -> None:
        """Forget what the policy inside remembers."""
        self._legs.reset()

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of the policy inside, of the velocities."""
        seen = replace(state, q=state.q[self._known], dq=state.dq[self._known])
        return self._legs.observe(seen, command[: self._count])

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the policy inside."""
        return self._legs.act(observation)

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy inside, and of the arms what the command says."""
        made = self._legs.targets(action, command[: self._count])
        q, kp, kd = self._spec.default_q.copy(), self._spec.kp.copy(), self._spec.kd.copy()
        q[self._known], kp[self._known], kd[self._known] = made.q, made.kp, made.kd
        q[self._arms] = command[self._count :]
        return JointTargets(q, kp, kd)

    def restore(self, observation: Floats32) -> None:
        """Restore what the policy inside remembers."""
        self._legs.restore(observation)
