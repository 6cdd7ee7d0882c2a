"""A policy that holds the default pose of another one, until that one takes over: how a real robot gets on its feet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from station import registry
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, PolicySpec, RobotState

# An arm that is held out with the 40 N m/rad of most policies sags by 0.06 rad: so soft joints are held firmer here, up
# to what Unitree's own example of a G1 holds them with.
_FIRM_KP, _FIRMER = 60.0, 1.5


class DefaultPosePolicy:
    """Implements `station.protocols.Policy`; it has no network, its action is the pose [rad].

    Args:
        checkpoint: File of the other policy.
        of: Registered name of the other policy.
        kp: Stiffness of every joint [N m/rad], for a first contact that should be soft; None for firm arms, and the
            other policy's stiffness elsewhere.

    Raises:
        ConfigError: a stiffness that holds nothing.
    """

    CHECKPOINT = "builtin:tracker.onnx"

    def __init__(self, checkpoint: Path, *, of: str = "tracker", kp: float | None = None) -> None:
        if kp is not None and not (isinstance(kp, int | float) and 0.0 < kp < np.inf):
            raise ConfigError(f"default-pose: kp is {kp!r}; expected more than 0 N m/rad")
        other: Policy = registry.find("policy", of)(checkpoint)
        pose = other.spec.default_q
        self._pose = pose.astype(np.float32)
        size = len(pose)
        its = other.spec.kp
        firm = np.where(its < _FIRM_KP, np.minimum(_FIRM_KP, _FIRMER * its), its) if kp is None else np.full(size, kp)
        self.spec: PolicySpec = replace(
            other.spec, name="default-pose", kp=firm, runtime="numpy", observation_size=size, action_size=size
        )

    def reset(self) -> None:
        """It has no history."""

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the joint positions, shape (n,) [rad]."""
        return state.q.astype(np.float32)

    def act(self, observation: Floats32) -> Floats32:
        """Return the pose, shape (n,) [rad]."""
        return self._pose

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the pose as targets."""
        return JointTargets(action.astype(np.float64), self.spec.kp, self.spec.kd)

    def restore(self, observation: Floats32) -> None:
        """It has no history."""
