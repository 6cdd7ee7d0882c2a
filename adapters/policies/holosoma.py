"""Holosoma's walking policies of the 29-joint G1, FastSAC and PPO: ONNX, 100 numbers in, 29 joint offsets out.

Observation: 0 previous output, clipped (29) · 29 gyro x 0.25 (3) · 32 yaw rate, vx, vy of the command (3) · 35 cosine
of both feet's phase (2) · 37 q - default (29) · 66 dq x 0.05 (29) · 95 gravity (3) · 98 sine of the phases (2).

The phase of the left foot goes round once a second, that of the right is half a turn ahead. It is advanced before each
inference; at a command of zero both are half a turn and the robot stands, and the first command to walk begins at 0.
Here it is a whole number of steps, so a recorded observation gives it back. Wire facts: PyPI ``holosoma-inference``
0.1.3, configuration and policies; gains and joints stand in the checkpoint.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from adapters.policies.follower import Loaded, VelocityFollower, clipped, gravity, joined
from adapters.policies.onnx_network import OnnxNetwork
from adapters.robots.g1.joints import G1_29
from station.errors import BadFile
from station.protocols import Floats, Floats32, RobotState

_LEG = (-0.312, 0.0, 0.0, 0.669, -0.363, 0.0)
DEFAULT_Q: Floats = np.array([*_LEG, *_LEG, 0, 0, 0, 0.2, 0.2, 0, 0.6, 0, 0, 0, 0.2, -0.2, 0, 0.6, 0, 0, 0], np.float64)
"""Joint positions at action zero of all of Holosoma's policies, in the order of `G1_29` [rad]."""
_CYCLE = 50
"""Steps of 20 ms in which the phase goes round."""
_STILL = 0.01  # [m/s], [rad/s]


class HolosomaPolicy(VelocityFollower):
    """Implements `station.protocols.Policy`."""

    NAME = "holosoma"
    ORIGIN = "the PyPI wheel holosoma-inference 0.1.3, models/loco/g1_29dof/{fastsac,ppo}_g1_29dof.onnx"
    JOINTS = G1_29
    DEFAULT_Q = DEFAULT_Q
    SCALE, OBSERVATION = 0.25, 100
    RANGE = ((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0))

    def _load(self, path: Path) -> Loaded:
        network = OnnxNetwork(path, inputs=self.OBSERVATION, outputs=len(self.JOINTS))
        return Loaded(network, network.runtime, gains_of(network, path))

    def reset(self) -> None:
        """Forget the previous output and the phase, as at start-up."""
        super().reset()
        self._step, self._walks = 0, True

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (100,), of the state of the 29 joints and a velocity, shape (3,)."""
        previous = clipped(self._previous())
        vx, vy, wz = command.tolist()
        walked, self._walks = self._walks, bool(np.hypot(vx, vy) >= _STILL or abs(wz) >= _STILL)
        self._step = (self._step + 1) % _CYCLE if self._walks and walked else 0
        left = self._step / _CYCLE
        phase = 2 * np.pi * np.array([left, left + 0.5] if self._walks else [0.5, 0.5])
        return joined(
            previous, state.gyro * 0.25, [wz, vx, vy], np.cos(phase), state.q - self.DEFAULT_Q, state.dq * 0.05,
            gravity(state), np.sin(phase),
        )  # fmt: skip

    def restore(self, observation: Floats32) -> None:
        """Restore previous output and phase from a recorded observation, shape (100,)."""
        super().restore(observation)
        cosine, sine = observation[35:37].astype(np.float64), observation[98:100].astype(np.float64)
        self._walks = bool(cosine.prod() + sine.prod() < 0)  # both feet have one phase, standing
        turns = np.arctan2(sine[0], cosine[0]) / (2 * np.pi)
        self._step = round(turns * _CYCLE) % _CYCLE if self._walks else 0


def gains_of(network: OnnxNetwork, path: Path) -> tuple[Floats, Floats]:
    """Return stiffness and damping of the 29 joints, as a checkpoint's metadata has them.

    Raises:
        BadFile: it has none, or is for other joints.
    """
    joints, *listed = (_listed(network, path, name) for name in ("dof_names", "kp", "kd"))
    if joints != [f"{name}_joint" for name in G1_29]:
        raise BadFile(f"{path}: is for other joints: {str(joints)[:80]}; expected the 29 of a G1 in Unitree's order")
    try:
        kp, kd = (np.array(gains, np.float64).reshape(len(G1_29)) for gains in listed)
    except ValueError:
        raise BadFile(f"{path}: expected {len(G1_29)} numbers each for kp and kd in its metadata") from None
    return kp, kd


def _listed(network: OnnxNetwork, path: Path, name: str) -> list[object]:
    try:
        found = json.loads(network.metadata[name])
    except (KeyError, ValueError):
        found = None
    if not isinstance(found, list):
        raise BadFile(f"{path}: its metadata has no list {name!r}; expected a checkpoint of Holosoma's policies")
    return found
