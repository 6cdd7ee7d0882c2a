"""Walking policies of unitree_rl_gym for G1, H1 and H1-2, legs alone: TorchScript with an LSTM of 64 units.

Inputs, A actions: 0 gyro x 0.25 (3) · 3 gravity (3) · 6 vx, vy, yaw rate of the command x 2, 2, 0.25 (3) · 9 q -
default (A) · 9+A dq x 0.05 (A) · 9+2A previous output (A) · sine and cosine of the phase, which goes round in 0.8 s and
runs at a command of zero too: the robot steps in place. Behind them the observation holds the LSTM's state before the
step, 64 hidden and 64 cell, so that a recording has all that decides. Wire facts: unitreerobotics/unitree_rl_gym,
``deploy/deploy_mujoco`` and ``deploy/deploy_real``.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from adapters.policies.follower import Loaded, VelocityFollower, gravity, joined
from adapters.policies.torchscript_network import LstmNetwork
from adapters.robots.g1.joints import LEGS
from station.protocols import Floats, Floats32, RobotState

UNITS = 64
_CYCLE = 40
"""Steps of 20 ms in which the phase goes round."""
_COMMAND_SCALE = np.array([2.0, 2.0, 0.25])


def _both(*leg: str) -> tuple[str, ...]:
    return tuple(f"{side}_{joint}" for side in ("left", "right") for joint in leg)


class RlGymPolicy(VelocityFollower):
    """`station.protocols.Policy` of the family; a robot's gives joints, default pose and gains."""

    FILE: ClassVar[str]
    SCALE = 0.25
    RANGE = ((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0))

    def reset(self) -> None:
        """Forget the previous output, the phase and the LSTM's state."""
        super().reset()
        self._step = 0
        self._memory: Floats32 = np.zeros(2 * UNITS, dtype=np.float32)

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, of the state of the legs' joints and a velocity, shape (3,)."""
        previous = self._previous()
        self._step = (self._step + 1) % _CYCLE
        phase = 2 * np.pi * self._step / _CYCLE
        return joined(
            state.gyro * 0.25, gravity(state), command * _COMMAND_SCALE, state.q - self.DEFAULT_Q, state.dq * 0.05,
            previous, [np.sin(phase), np.cos(phase)], self._memory,
        )  # fmt: skip

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the network, of inputs and LSTM state as the observation has them."""
        action = super().act(observation)
        self._memory = self._lstm.state
        return action

    def restore(self, observation: Floats32) -> None:
        """Restore output, phase and LSTM state from a recorded observation."""
        super().restore(observation)
        sine, cosine = observation[-2 * UNITS - 2 : -2 * UNITS].tolist()
        self._step = round(np.arctan2(sine, cosine) / (2 * np.pi) * _CYCLE) % _CYCLE

    def _load(self, path: Path) -> Loaded:
        inputs, actions = self.OBSERVATION - 2 * UNITS, len(self.JOINTS)
        self._lstm = LstmNetwork(path, inputs=inputs, outputs=actions, units=UNITS)
        return Loaded(self._lstm, self._lstm.runtime, self.GAINS)


_ORIGIN = "unitreerobotics/unitree_rl_gym on GitHub (BSD-3-Clause), deploy/pre_train/{}/motion.pt"


class RlGymG1Policy(RlGymPolicy):
    """Of a G1 with 12 joints."""

    NAME, ORIGIN = "rlgym-g1", _ORIGIN.format("g1")
    JOINTS, OBSERVATION = LEGS, 47 + 2 * UNITS
    DEFAULT_Q = np.array([-0.1, 0, 0, 0.3, -0.2, 0] * 2, dtype=np.float64)
    GAINS = np.array([100.0, 100, 100, 150, 40, 40] * 2), np.array([2.0, 2, 2, 4, 2, 2] * 2)


class RlGymH1Policy(RlGymPolicy):
    """Of an H1 with 10 joints."""

    NAME, ORIGIN = "rlgym-h1", _ORIGIN.format("h1")
    JOINTS, OBSERVATION = _both("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle"), 41 + 2 * UNITS
    DEFAULT_Q = np.array([0, 0, -0.1, 0.3, -0.2] * 2, dtype=np.float64)
    GAINS = np.array([150.0, 150, 150, 200, 40] * 2), np.array([2.0, 2, 2, 4, 2] * 2)


class RlGymH12Policy(RlGymPolicy):
    """Of an H1-2 with 12 joints."""

    NAME, ORIGIN = "rlgym-h1-2", _ORIGIN.format("h1_2")
    JOINTS = _both("hip_yaw", "hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll")
    OBSERVATION = 47 + 2 * UNITS
    DEFAULT_Q = np.array([0, -0.16, 0, 0.36, -0.2, 0] * 2, dtype=np.float64)
    GAINS = np.array([200.0, 200, 200, 300, 40, 40] * 2), np.array([2.5, 2.5, 2.5, 4, 2, 2] * 2)
