"""TWIST's whole-body policy: a TorchScript network, 1155 numbers in, 23 joint offsets out.

One frame (105), float32: command without wrist rolls (31) · gyro x 0.25 (3) · roll, pitch (2) · q - default (23) ·
dq x 0.05, ankles zero (23) · previous raw output (23). Observation: the present frame, then ten past frames, oldest
first, the present one not among them. The wrist rolls of the command go straight to the servos; the other wrist
joints are held at zero. Wire facts: YanjieZe/TWIST, `server_low_level_g1_sim.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.policies.history import FrameHistory
from adapters.policies.torchscript_network import TorchScriptNetwork
from adapters.policies.twist2 import ACTION_CLIP, ACTION_SCALE, ANKLES, GYRO_SCALE, VELOCITY_SCALE, gains
from adapters.robots.g1.joints import G1_23, G1_25, G1_29
from station.assets import sha256
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState
from station.rotations import roll_pitch_yaw

COMMAND, FRAME, PAST, ACTIONS = 31, 105, 10, 23
OBSERVATION = FRAME * (1 + PAST)
PROPRIOCEPTION = FRAME - COMMAND

_COMMAND_HEAD = 8  # height, roll, pitch, yaw, three velocities, yaw rate; then the joints of G1_25
_NOT_WRIST_ROLL = np.array([*range(_COMMAND_HEAD), *(_COMMAND_HEAD + G1_25.index(name) for name in G1_23)])
_WRIST_ROLLS = ("left_wrist_roll", "right_wrist_roll")
_WRIST_ROLL_COMMANDS = np.array([_COMMAND_HEAD + G1_25.index(name) for name in _WRIST_ROLLS])
_WRIST_ROLL_JOINTS = np.array([G1_29.index(name) for name in _WRIST_ROLLS])
_JOINTS = np.array([G1_29.index(name) for name in G1_23])

_LEG = (-0.2, 0.0, 0.0, 0.4, -0.2, 0.0)
DEFAULT_Q = np.array([*_LEG, *_LEG, 0, 0, 0, 0, 0.4, 0, 1.2, 0, -0.4, 0, 1.2], dtype=np.float64)
"""Positions of the policy's 23 joints at action zero [rad]."""

_WRIST_GAINS = (20.0, 1.0)  # wrist roll, in simulation and on the robot alike; we hold the other wrist joints with it


class TwistPolicy:
    """Implements `station.protocols.Policy`; arithmetic as in `adapters.policies.twist2`.

    TorchScript can run code of its author's choosing: load only files you trust. Needs the extra ``torch``.

    Args:
        checkpoint: The ``.pt`` file.

    Raises:
        StationError: torch is not installed.
        BadFile: missing, not TorchScript, or not of TWIST's sizes.
    """

    def __init__(self, checkpoint: Path) -> None:
        path = Path(checkpoint)
        self._network = TorchScriptNetwork(path, inputs=OBSERVATION, outputs=ACTIONS)
        kp, kd = gains(*_WRIST_GAINS)
        self._spec = PolicySpec(
            name="twist", checkpoint=path, sha256=sha256(path), runtime=self._network.runtime,
            rate_hz=50.0, command="twist", joint_names=G1_29, default_q=_spread(DEFAULT_Q), kp=kp, kd=kd,
            observation_size=OBSERVATION, action_size=ACTIONS,
        )  # fmt: skip
        self._history = FrameHistory(PAST, FRAME)
        self._action: Floats32 = np.zeros(ACTIONS, dtype=np.float32)
        self._restored: Floats32 | None = None

    @property
    def spec(self) -> PolicySpec:
        """The constants of this policy."""
        return self._spec

    def reset(self) -> None:
        """Forget history and previous output: all zero."""
        self._history.clear()
        self._action = np.zeros(ACTIONS, dtype=np.float32)
        self._restored = None

    def proprioception(self, state: RobotState) -> Floats32:
        """Return what the network sees of the robot, shape (74,), scaled; stock TWIST puts it on the bus as state."""
        if self._restored is not None:
            self.act(self._restored)
        scaled = np.empty(PROPRIOCEPTION, dtype=np.float32)
        scaled[0:3] = state.gyro * GYRO_SCALE
        scaled[3:5] = roll_pitch_yaw(state.quat_wxyz)[:2]
        scaled[5:28] = state.q[_JOINTS] - DEFAULT_Q
        scaled[28:51] = state.dq[_JOINTS] * VELOCITY_SCALE
        scaled[28 + ANKLES] = 0.0
        scaled[51:74] = self._action
        return scaled

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (1155,).

        Args:
            state: Of the 29 joints.
            command: TWIST's command, shape (33,).
        """
        observation = np.empty(OBSERVATION, dtype=np.float32)
        frame = observation[:FRAME]
        frame[:COMMAND] = command[_NOT_WRIST_ROLL]
        frame[COMMAND:] = self.proprioception(state)
        observation[FRAME:] = self._history.flat
        self._history.push(frame)
        return observation

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the network, shape (23,), before clipping."""
        self._action = self._network(observation)
        self._restored = None
        return self._action

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + 0.5 x the output clipped to ±10, and the wrist rolls of the command."""
        q = np.clip(action.astype(np.float64), -ACTION_CLIP, ACTION_CLIP) * ACTION_SCALE + DEFAULT_Q
        targets = _spread(q)
        targets[_WRIST_ROLL_JOINTS] = command[_WRIST_ROLL_COMMANDS]
        return JointTargets(targets, self._spec.kp, self._spec.kd)

    def restore(self, observation: Floats32) -> None:
        """Restore the history that a recorded observation, shape (1155,), shows; see `Twist2Policy.restore`."""
        self._history.fill(observation[FRAME:])
        self._history.push(observation[:FRAME])
        self._restored = np.array(observation, dtype=np.float32)


def _spread(q_23: Floats) -> Floats:
    """Put the policy's 23 joints into 29, wrists at zero."""
    q = np.zeros(len(G1_29))
    q[_JOINTS] = q_23
    return q
