"""A small policy with a history, for audits that need no upstream data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.robots.g1.joints import G1_29
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState

SIZE = 4


class LinearPolicy:
    """Observation: command height, first joint, its last output, and the observation before; action: their sum."""

    def __init__(self, *, gain: float = 1.0) -> None:
        self._gain = np.float32(gain)
        self.reset()

    @property
    def spec(self) -> PolicySpec:
        zeros = np.zeros(29)
        return PolicySpec(
            name="linear", checkpoint=Path("linear"), sha256="1" * 64, runtime="numpy", rate_hz=50.0,
            command="twist2", joint_names=G1_29, default_q=zeros, kp=zeros, kd=zeros, observation_size=SIZE,
            action_size=1,
        )  # fmt: skip

    def reset(self) -> None:
        self._past, self._action = np.float32(0), np.float32(0)

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        observation = np.array([command[2], state.q[0], self._action, self._past], dtype=np.float32)
        self._past = observation[1]
        return observation

    def act(self, observation: Floats32) -> Floats32:
        self._action = np.float32(observation.sum() * self._gain)
        return np.array([self._action], dtype=np.float32)

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        return JointTargets(np.full(29, float(action[0])), np.zeros(29), np.zeros(29))

    def restore(self, observation: Floats32) -> None:
        self._past = observation[1]
        self._action = np.float32(observation.sum() * self._gain)
