"""GR00T's decoupled whole-body control, legs and waist of the G1: two ONNX networks, 6 frames of 86 numbers in, 15 out.

A frame: 0 vx, vy, yaw rate of the command x 2, 2, 0.5 (3) · 3 height of the base [m] (1) · 4 roll, pitch, yaw of the
torso (3) · 7 gyro x 0.5 (3) · 10 gravity (3) · 13 q - default (29) · 42 dq x 0.05 (29) · 71 previous output, clipped
(15). Frames are zero at the start, the oldest one first. Below a velocity of 0.05 the network of the checkpoint
balances, else the other one walks; both share frames and output. Arms are held; whoever commands them puts
`adapters.policies.g1_arms` around it. Wire facts: NVlabs/GR00T-WholeBodyControl, ``decoupled_wbc``; what it was trained
on is not said there, so the range is ours.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.commands.velocity import WITH_POSTURE
from adapters.policies.follower import Loaded, gravity, joined
from adapters.policies.homie import FramedG1
from adapters.policies.onnx_network import OnnxNetwork
from station import assets
from station.errors import ConfigError
from station.protocols import Floats, Floats32, RobotState

_VELOCITY_SCALE = np.array([2.0, 2.0, 0.5])
_STILL = 0.05  # norm of vx, vy [m/s] and yaw rate [rad/s]


class GrootWbcPolicy(FramedG1):
    """Implements `station.protocols.Policy`.

    Args:
        checkpoint: The network that balances, ``…-Balance.onnx``.
        walk: The network that walks, ``…-Walk.onnx``, a path or ``collection:path``.
    """

    NAME = "groot-wbc"
    ORIGIN = "NVlabs/GR00T-WholeBodyControl on GitHub (NVIDIA Open Model License), decoupled_wbc: …-Balance.onnx"
    COMMAND = WITH_POSTURE
    FRAME, OBSERVATION, ACTIONS = 86, 6 * 86, 15
    RANGE = ((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0), (0.24, 0.74), *[(-0.52, 0.52)] * 3)
    GAINS = (
        np.array([*[150.0, 150, 150, 200, 40, 40] * 2, 250, 250, 250, *[100.0, 100, 40, 40, 20, 20, 20] * 2]),
        np.array([*[2.0, 2, 2, 4, 2, 2] * 2, 5, 5, 5, *[5.0, 5, 2, 2, 2, 2, 2] * 2]),
    )

    def __init__(self, checkpoint: Path, *, walk: str = "") -> None:
        if not walk:
            raise ConfigError(
                "policy 'groot-wbc' has two networks, and only the one that balances is named; name the one that walks "
                "with the option `walk`, the file …-Walk.onnx"
            )
        self._walk_file = assets.resolve(walk)
        super().__init__(checkpoint)

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the network that the newest frame's velocity asks for, shape (15,)."""
        velocity = observation[-self.FRAME :][:3] / _VELOCITY_SCALE
        self._network = self._balances if np.linalg.norm(velocity) < _STILL else self._walks
        return super().act(observation)

    def _load(self, path: Path) -> Loaded:
        self._balances, self._walks = (
            OnnxNetwork(each, inputs=self.OBSERVATION, outputs=self.ACTIONS) for each in (path, self._walk_file)
        )
        return Loaded(
            self._balances, f"{self._balances.runtime}, walks by {assets.sha256(self._walk_file)[:12]}", self.GAINS
        )

    def _frame(self, state: RobotState, command: Floats, previous: Floats) -> Floats32:
        return joined(
            command[:3] * _VELOCITY_SCALE, command[3:], state.gyro * 0.5, gravity(state), state.q - self.DEFAULT_Q,
            state.dq * 0.05, previous,
        )  # fmt: skip
