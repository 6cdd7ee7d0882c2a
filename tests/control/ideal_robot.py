"""A robot whose joints are where they were asked to be, and a policy that asks for what the command says."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from adapters.robots.g1.joints import G1_29
from station.protocols import Fall, Floats, Floats32, JointTargets, PolicySpec, RobotState


class IdealRobot:
    """Is where it was asked to be, as far as its stiffness goes.

    Args:
        now_ns: Says when it was read.
    """

    joint_names = G1_29

    def __init__(self, now_ns: Callable[[], int] = lambda: 1) -> None:
        self._now_ns = now_ns
        self.q = np.zeros(29)
        self.written: list[JointTargets] = []
        self.fall: Fall | None = None
        self.resets = self.damped = 0

    def read(self) -> RobotState:
        return RobotState(
            mono_ns=self._now_ns(), q=self.q.copy(), dq=np.zeros(29), quat_wxyz=np.array([1.0, 0, 0, 0]),
            gyro=np.zeros(3), root_pos=np.array([0, 0, 0.8]),
        )  # fmt: skip

    def write(self, targets: JointTargets) -> JointTargets:
        self.written.append(targets)
        self.q = np.where(targets.kp > 0, targets.q, self.q)
        return targets

    def damp(self) -> None:
        self.damped += 1

    def fallen(self) -> Fall | None:
        return self.fall

    def facts(self) -> dict[str, Any]:
        return {}

    def close(self) -> None:
        pass


class IdealSimulation(IdealRobot):
    def reset(self) -> None:
        self.resets += 1
        self.fall = None


class Obedient:
    """A policy that gives what the command asks for; its output can be spoilt."""

    def __init__(self) -> None:
        self.spec = PolicySpec(
            name="obedient", checkpoint=Path("none"), sha256="", runtime="none", rate_hz=50.0, command="twist2",
            joint_names=G1_29, default_q=np.zeros(29), kp=np.full(29, 50.0), kd=np.full(29, 2.0),
            observation_size=35, action_size=29,
        )  # fmt: skip
        self.is_broken = False
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        return command.astype(np.float32)

    def act(self, observation: Floats32) -> Floats32:
        action = observation[6:].copy()
        if self.is_broken:
            action[5] = math.nan
        return action

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        return JointTargets(action.astype(np.float64), self.spec.kp, self.spec.kd)

    def restore(self, observation: Floats32) -> None:
        pass
