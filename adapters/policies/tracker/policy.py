"""The station's own whole-body policy: an ONNX network, 635 numbers in, 29 joint offsets out.

Observation, float32: the five newest frames of 127 numbers, oldest first, the present one last; a frame is that of
`adapters.policies.twist2` (command, gyro, roll, pitch, joints, joint speeds, previous raw output). Frames are zero at
the start. Gains, default pose and the meaning of the output are TWIST2's too, so either policy drives the same robot
with the same commands. How it was made stands beside it, in ``MODEL_CARD.md``.
"""

from __future__ import annotations

import numpy as np

from adapters.policies.twist2 import ACTIONS, FRAME, FramePolicy
from station.protocols import Floats, Floats32, RobotState

__all__ = ["ACTIONS", "FRAMES", "OBSERVATION", "TrackerPolicy"]

FRAMES = 5
OBSERVATION = FRAMES * FRAME


class TrackerPolicy(FramePolicy):
    """Implements `station.protocols.Policy`."""

    CHECKPOINT = "builtin:tracker.onnx"
    NAME, KEPT, INPUTS = "tracker", FRAMES, OBSERVATION

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (635,).

        Args:
            state: Of the 29 joints.
            command: TWIST2's body command, shape (35,).
        """
        self._history.push(self._frame(state, command))
        return self._history.flat.copy()

    def restore(self, observation: Floats32) -> None:
        """Restore the history that a recorded observation, shape (635,), shows; see `Twist2Policy.restore`."""
        self._history.fill(observation)
        self._restored = np.array(observation, dtype=np.float32)
