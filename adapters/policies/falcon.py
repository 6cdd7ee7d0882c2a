"""FALCON's policy of a G1, for legs, torso and arms at once: ONNX, 5 frames of 115 numbers in, 29 joint offsets out.

A frame: 0 previous output, clipped (29) · 29 gyro x 0.25 (3) · 32 yaw rate of the command (1) · 33 height of the base
[m] x 2 (1) · 34 vx, vy (2) · 36 whether it walks: 1 unless all three are zero (1) · 37 yaw, roll, pitch of the torso
(3) · 40 q - default (29) · 69 dq x 0.05 (29) · 98 gravity (3) · 101 positions that the arms are to take (14). Frames
are zero at the start, the oldest one first. The offsets of the legs and the waist are from the default pose, those of
the arms from the commanded positions: it balances with the arms, too.

Wire facts: LeCAR-Lab/FALCON, ``sim2real``, configuration and policy. What it was trained on is not said there: the
range of velocities and heights is what it followed here.
"""

from __future__ import annotations

import numpy as np

from adapters.commands.g1_parts import ARMS, VELOCITY_POSTURE
from adapters.policies.follower import gravity, joined
from adapters.policies.homie import FramedG1
from adapters.robots.g1 import joints as g1
from station.protocols import Floats, Floats32, JointTargets, RobotState

_ARMS = slice(15, 29)
_TOLD = slice(7, None)  # of a command: positions of the arms
_YAW_ROLL_PITCH = [6, 4, 5]


class FalconPolicy(FramedG1):
    """Implements `station.protocols.Policy`."""

    NAME = "falcon"
    ORIGIN = "LeCAR-Lab/FALCON on GitHub (MIT), sim2real/models/falcon/g1_29dof.onnx"
    COMMAND = VELOCITY_POSTURE
    FRAMES, FRAME, OBSERVATION, ACTIONS = 5, 115, 5 * 115, 29
    RANGE = (
        (-0.5, 1.0), (-0.5, 0.5), (-1.0, 1.0), (0.4, 0.75), *[(-0.5, 0.5)] * 3,
        *zip(g1.lower(ARMS).tolist(), g1.upper(ARMS).tolist(), strict=True),
    )  # fmt: skip
    GAINS = (
        np.array([*[100.0, 100, 100, 200, 20, 20] * 2, *[300.0] * 3, *[90.0, 60, 20, 60, 4, 4, 4] * 2]),
        np.array([*[2.5, 2.5, 2.5, 5, 0.2, 0.1] * 2, *[5.0] * 3, *[2.0, 1, 0.4, 1, 0.2, 0.2, 0.2] * 2]),
    )

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return default + scale x the clipped output; for the arms, the commanded positions + that."""
        made = super().targets(action, command)
        made.q[_ARMS] += command[_TOLD]
        return made

    def _frame(self, state: RobotState, command: Floats, previous: Floats) -> Floats32:
        vx, vy, wz, height = command[:4].tolist()
        walks = float(vx != 0.0 or vy != 0.0 or wz != 0.0)
        return joined(
            previous, state.gyro * 0.25, [wz, 2.0 * height, vx, vy, walks], command[_YAW_ROLL_PITCH],
            state.q - self.DEFAULT_Q, state.dq * 0.05, gravity(state), command[_TOLD],
        )  # fmt: skip
