"""The station's own whole-body policy: an ONNX network, 635 numbers in, 29 joint offsets out.

Observation, float32: the five newest frames of 127 numbers, oldest first, the present one last; a frame is that of
`adapters.policies.twist2` (command, gyro, roll, pitch, joints, joint speeds, previous raw output). Frames are zero at
the start. Gains, default pose and the meaning of the output are TWIST2's too, so either policy drives the same robot
with the same commands. How it was made stands beside it, in ``MODEL_CARD.md``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adapters.policies.history import FrameHistory
from adapters.policies.onnx_network import OnnxNetwork
from adapters.policies.twist2 import DEFAULT_Q, FRAME, WRIST_GAINS, WristGains, gains, offsets, write_frame
from station.assets import sha256
from station.bus.joints import G1_29
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, PolicySpec, RobotState

FRAMES, ACTIONS = 5, 29
OBSERVATION = FRAMES * FRAME


class TrackerPolicy:
    """Implements `station.protocols.Policy`; arithmetic as in `adapters.policies.twist2`.

    Args:
        checkpoint: The ``.onnx`` file.
        wrist_gains: Which set of `WRIST_GAINS` the wrists get.

    Raises:
        BadFile: missing, not ONNX, or not of the tracker's sizes.
        ConfigError: no such set of gains.
    """

    def __init__(self, checkpoint: Path, *, wrist_gains: WristGains = "sim") -> None:
        if wrist_gains not in WRIST_GAINS:
            raise ConfigError(f"wrist_gains {wrist_gains!r}: expected one of {', '.join(WRIST_GAINS)}")
        path = Path(checkpoint)
        self._network = OnnxNetwork(path, inputs=OBSERVATION, outputs=ACTIONS)
        kp, kd = gains(*WRIST_GAINS[wrist_gains])
        self._spec = PolicySpec(
            name="tracker", checkpoint=path, sha256=sha256(path), runtime=self._network.runtime, rate_hz=50.0,
            command="twist2", joint_names=G1_29, default_q=DEFAULT_Q, kp=kp, kd=kd,
            observation_size=OBSERVATION, action_size=ACTIONS,
        )  # fmt: skip
        self._history = FrameHistory(FRAMES, FRAME)
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

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (635,).

        Args:
            state: Of the 29 joints.
            command: TWIST2's body command, shape (35,).
        """
        if self._restored is not None:  # the output of the restored step is part of this observation
            self.act(self._restored)
        frame = np.empty(FRAME, dtype=np.float32)
        write_frame(frame, state, command, self._action)
        self._history.push(frame)
        return self._history.flat.copy()

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the network, shape (29,), before clipping."""
        self._action = self._network(observation)
        self._restored = None
        return self._action

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + 0.5 x the output clipped to ±10; nothing of the command bypasses the network."""
        return JointTargets(offsets(action), self._spec.kp, self._spec.kd)

    def restore(self, observation: Floats32) -> None:
        """Take up the history that a recorded observation, shape (635,), shows; see `Twist2Policy.restore`."""
        self._history.fill(observation)
        self._restored = np.array(observation, dtype=np.float32)
