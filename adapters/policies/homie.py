"""HOMIE's walking policy of the G1: ONNX, 6 frames of 76 numbers in, 12 leg joints out; arms as they are.

A frame: 0 vx, vy, yaw rate of the command x 2, 2, 0.5 (3) · 3 height of the base [m] (1) · 4 gyro x 0.5 (3) · 7 gravity
(3) · 10 q - default of legs, waist yaw and arms (27) · 37 dq x 0.05 of those (27) · 64 previous output, clipped (12).
Frames are zero at the start, the oldest one first. Waist and arms are held; whoever commands arms puts
`adapters.policies.g1_arms` around it.

Wire facts: InternRobotics/OpenHomie, deployment and training code. Its deployment scales the yaw rate by 0.25, its
training by 0.5; with 0.25 the robot does not turn at 0.5 rad/s, so 0.5 it is. At its first step it infers from zeros
alone; here the first frame is in the history at once, so that every action follows from its observation.
"""

from __future__ import annotations

import numpy as np

from adapters.commands.velocity import WITH_HEIGHT
from adapters.policies.follower import FramedFollower, gravity, joined
from adapters.robots.g1.joints import G1_29
from station.protocols import Floats, Floats32, RobotState

_LEG = (-0.1, 0.0, 0.0, 0.3, -0.2, 0.0)


class FramedG1(FramedFollower):
    """What policies of a G1 share whose outputs are the first of its 29 joints; the others are held at zero."""

    JOINTS, SCALE = G1_29, 0.25
    DEFAULT_Q = np.array([*_LEG, *_LEG, *[0.0] * 17])


class HomiePolicy(FramedG1):
    """Implements `station.protocols.Policy`."""

    NAME = "homie"
    ORIGIN = "InternRobotics/OpenHomie on GitHub (CC BY-NC-SA 4.0, no commercial use), HomieDeploy: deploy.onnx"
    COMMAND = WITH_HEIGHT
    FRAME, OBSERVATION, ACTIONS = 76, 6 * 76, 12
    RANGE = ((-0.8, 1.2), (-0.5, 0.5), (-0.8, 0.8), (0.24, 0.74))
    GAINS = (
        np.array([*[150.0, 150, 150, 300, 40, 40] * 2, 300, 300, 300, *[150.0, 150, 150, 100, 10, 10, 5] * 2]),
        np.array([*[2.0, 2, 2, 4, 2, 2] * 2, 5, 5, 5, *[4.0, 4, 4, 1, 0.5, 0.5, 0.5] * 2]),
    )

    def _frame(self, state: RobotState, command: Floats, previous: Floats) -> Floats32:
        return joined(
            command * _COMMAND_SCALE, state.gyro * 0.5, gravity(state), (state.q - self.DEFAULT_Q)[_SEEN],
            state.dq[_SEEN] * 0.05, previous,
        )  # fmt: skip


_COMMAND_SCALE = np.array([2.0, 2.0, 0.5, 1.0])
_SEEN = [*range(13), *range(15, 29)]
"""Of the 29 joints: all but the waist's roll and pitch."""
