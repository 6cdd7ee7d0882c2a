"""pilla_rl's walking policy of the Go2: TorchScript, 45 numbers in, 12 joint offsets out.

Observation: 0 gyro x 0.25 (3) · 3 gravity (3) · 6 vx, vy, yaw rate of the command x 2, 2, 0.25 (3) · 9 q - default (12)
· 21 dq x 0.05 (12) · 33 previous output, clipped (12). The network has its joints in the order of Unitree's SDK (FR,
FL, RR, RL), the robot in that of its model (FL, FR, RL, RR). It was trained in Genesis with one step of latency: a
target is that of the output before, which stands in the observation. Without it, or with rotors much lighter than
0.1 kg m^2, it falls. Wire facts: code-name-57/pilla_rl and pilla_rl_ros.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.policies.follower import Loaded, VelocityFollower, clipped, gravity, joined
from adapters.policies.torchscript_network import TorchScriptNetwork
from station.protocols import Floats, Floats32, JointTargets, RobotState

_SDK = np.array([3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8])
"""From the model's order to the SDK's, and back."""
_COMMAND_SCALE = np.array([2.0, 2.0, 0.25])
_PREVIOUS = slice(33, 45)


class PillaGo2Policy(VelocityFollower):
    """Implements `station.protocols.Policy`."""

    NAME = "pilla-go2"
    ORIGIN = "code-name-57/pilla_rl_ros on GitHub (no licence is declared), pilla_rl_ros/policy.jit"
    JOINTS = tuple(f"{leg}_{joint}" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf"))
    DEFAULT_Q = np.array([0, 0.8, -1.5, 0, 0.8, -1.5, 0, 1.0, -1.5, 0, 1.0, -1.5])
    GAINS = np.full(12, 20.0), np.full(12, 0.5)
    SCALE, OBSERVATION = 0.25, 45
    RANGE = ((-1.0, 2.0), (-0.5, 0.5), (-0.5, 0.5))

    def reset(self) -> None:
        """Forget the previous output: zero."""
        super().reset()
        self._applied: Floats32 = np.zeros(12, dtype=np.float32)

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (45,), of the state of the 12 joints and a velocity, shape (3,)."""
        return joined(
            state.gyro * 0.25, gravity(state), command * _COMMAND_SCALE, (state.q - self.DEFAULT_Q)[_SDK],
            state.dq[_SDK] * 0.05, clipped(self._previous()),
        )  # fmt: skip

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the network, shape (12,), in the SDK's order."""
        action = super().act(observation)
        self._applied = observation[_PREVIOUS]
        return action

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + 0.25 x the output of the step before."""
        return super().targets(self._applied[_SDK], command)

    def _load(self, path: Path) -> Loaded:
        network = TorchScriptNetwork(path, inputs=self.OBSERVATION, outputs=len(self.JOINTS))
        return Loaded(network, network.runtime, self.GAINS)
