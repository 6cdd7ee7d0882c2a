"""TWIST2's whole-body policy: an ONNX network, 1432 numbers in, 29 joint offsets out.

Observation, float32, at offset: 0 command (35) · 35 gyro x 0.25 (3) · 38 roll, pitch (2) · 40 q - default (29) ·
69 dq x 0.05, ankles zero (29) · 98 previous raw output (29) · 127 ten past frames of 127 (0-126 of the past steps),
oldest first, the present one not among them · 1397 the command again (35). History and previous output are zero at
the start. Wire facts: amazon-far/TWIST2, `server_low_level_g1_sim.py`, and the shipped checkpoints.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from adapters.policies.history import FrameHistory
from adapters.policies.onnx_network import OnnxNetwork
from adapters.robots.g1.joints import G1_29
from station.assets import sha256
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState
from station.rotations import roll_pitch_yaw

COMMAND, FRAME, PAST, ACTIONS = 35, 127, 10, 29
OBSERVATION = FRAME + PAST * FRAME + COMMAND

_LEG = (-0.2, 0.0, 0.0, 0.4, -0.2, 0.0)
DEFAULT_Q = np.array([*_LEG, *_LEG, 0, 0, 0, 0, 0.4, 0, 1.2, 0, 0, 0, 0, -0.4, 0, 1.2, 0, 0, 0], dtype=np.float64)
"""Joint positions at action zero [rad]."""

ANKLES = np.array([4, 5, 10, 11])
GYRO_SCALE, VELOCITY_SCALE, ACTION_SCALE, ACTION_CLIP = 0.25, 0.05, 0.5, 10.0

WristGains = Literal["sim", "real", "training"]
WRIST_GAINS: dict[WristGains, tuple[float, float]] = {"sim": (4.0, 0.2), "real": (20.0, 1.0), "training": (40.0, 5.0)}
"""Stiffness and damping of the six wrist joints: upstream uses three sets (its simulation, its robot, its training).

"sim" is the default: the stock simulation and all published figures use it, and there the wrists have no rotor
inertia and a torque clip of 4 N m. The robot needs "real" (gear friction eats a 4 N m/rad servo).
"""


class FramePolicy:
    """What TWIST2's policy and ours, which follows the same command, have in common: frames, gains, targets.

    The arithmetic, so that an audit can repeat it bit for bit: differences and scalings in float64, each rounded once
    to float32 when it enters the frame; the network in float32; targets in float64.

    Args:
        checkpoint: The ``.onnx`` file.
        wrist_gains: Which set of `WRIST_GAINS` the wrists get.

    Raises:
        BadFile: missing, not ONNX, or not of this family's sizes.
        ConfigError: no such set of gains.
    """

    NAME: ClassVar[str]
    KEPT: ClassVar[int]
    """Frames that the history keeps."""
    INPUTS: ClassVar[int]
    """Numbers in an observation."""

    def __init__(self, checkpoint: Path, *, wrist_gains: WristGains = "sim") -> None:
        if wrist_gains not in WRIST_GAINS:
            raise ConfigError(f"wrist_gains {wrist_gains!r}: expected one of {', '.join(WRIST_GAINS)}")
        path = Path(checkpoint)
        self._network = OnnxNetwork(path, inputs=self.INPUTS, outputs=ACTIONS)
        kp, kd = gains(*WRIST_GAINS[wrist_gains])
        self._spec = PolicySpec(
            name=self.NAME, checkpoint=path, sha256=sha256(path), runtime=self._network.runtime, rate_hz=50.0,
            command="twist2", joint_names=G1_29, default_q=DEFAULT_Q, kp=kp, kd=kd,
            observation_size=self.INPUTS, action_size=ACTIONS,
        )  # fmt: skip
        self._history = FrameHistory(self.KEPT, FRAME)
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

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the network, shape (29,), before clipping."""
        self._action = self._network(observation)
        self._restored = None
        return self._action

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + 0.5 x the output clipped to ±10; nothing of the command bypasses the network."""
        return JointTargets(offsets(action), self._spec.kp, self._spec.kd)

    def _frame(self, state: RobotState, command: Floats) -> Floats32:
        """Return the frame of this step, shape (127,)."""
        if self._restored is not None:  # the output of the restored step is part of this frame
            self.act(self._restored)
        frame = np.empty(FRAME, dtype=np.float32)
        write_frame(frame, state, command, self._action)
        return frame


class Twist2Policy(FramePolicy):
    """Implements `station.protocols.Policy`."""

    CHECKPOINT = "twist2:ckpts/twist2_1017_20k.onnx"
    NAME, KEPT, INPUTS = "twist2", PAST, OBSERVATION

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (1432,).

        Args:
            state: Of the 29 joints.
            command: TWIST2's body command, shape (35,).
        """
        frame = self._frame(state, command)
        observation = np.concatenate([frame, self._history.flat, frame[:COMMAND]])
        self._history.push(frame)
        return observation

    def restore(self, observation: Floats32) -> None:
        """Restore the history that a recorded observation, shape (1432,), shows.

        The next step needs the nine newest past frames, this step's frame, and this step's output; the last is not in
        the observation and is inferred from it, unless the caller does so with `act`.
        """
        self._history.fill(observation[FRAME:-COMMAND])
        self._history.push(observation[:FRAME])
        self._restored = np.array(observation, dtype=np.float32)


def write_frame(frame: Floats32, state: RobotState, command: Floats, action: Floats32) -> None:
    """Fill a frame, shape (127,): command, state of the 29 joints, and the previous raw output, shape (29,)."""
    frame[0:35] = command
    frame[35:38] = state.gyro * GYRO_SCALE
    frame[38:40] = roll_pitch_yaw(state.quat_wxyz)[:2]
    frame[40:69] = state.q - DEFAULT_Q
    frame[69:98] = state.dq * VELOCITY_SCALE
    frame[69 + ANKLES] = 0.0
    frame[98:127] = action


def offsets(action: Floats32) -> Floats:
    """Return the joint positions that a raw output asks for, shape (29,) [rad]."""
    return np.clip(action.astype(np.float64), -ACTION_CLIP, ACTION_CLIP) * ACTION_SCALE + DEFAULT_Q


def gains(wrist_kp: float, wrist_kd: float) -> tuple[Floats, Floats]:
    """Return stiffness and damping of the 29 joints; TWIST and TWIST2 agree on all but the wrists."""
    kp = [100, 100, 100, 150, 40, 40] * 2 + [150] * 3 + ([40] * 4 + [wrist_kp] * 3) * 2
    kd = [2, 2, 2, 4, 2, 2] * 2 + [4] * 3 + ([5] * 4 + [wrist_kd] * 3) * 2
    return np.array(kp, dtype=np.float64), np.array(kd, dtype=np.float64)
