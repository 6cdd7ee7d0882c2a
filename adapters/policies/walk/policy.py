"""The station's own policies that follow velocities: ONNX; five frames in, an offset per driven joint out.

A frame: gyro (3) · gravity (3) · vx, vy, yaw rate of the command (3) · q - default (n) · dq x 0.05 (n) · previous
output (m). Frames are zero at the start, the oldest one first. The Go2 (n = m = 12) and the G1 (n = 29, m = 15: legs
and waist). Whoever commands a G1's arms puts `adapters.policies.g1_arms` around it: it was trained with arms that move,
and feels where they are. How they were made stands beside them, in ``MODEL_CARD.md``.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from adapters.commands import twist2
from adapters.policies.falcon import FalconPolicy
from adapters.policies.follower import FramedFollower, gravity, joined
from adapters.policies.groot_wbc import GrootWbcPolicy
from adapters.robots.g1.joints import G1_29, LEGS, WAIST
from station.protocols import Floats, Floats32, RobotState

SPEED_SCALE = 0.05
_DRIVEN = len(LEGS) + len(WAIST)


class WalkPolicy(FramedFollower):
    """Implements `station.protocols.Policy` but for the constants of a robot."""

    CHECKPOINT: ClassVar[str]
    ORIGIN = ""
    FRAMES = 5

    def _frame(self, state: RobotState, command: Floats, previous: Floats) -> Floats32:
        return joined(
            state.gyro, gravity(state), command, state.q - self.DEFAULT_Q, state.dq * SPEED_SCALE, previous
        )  # fmt: skip


class Go2WalkPolicy(WalkPolicy):
    """Of a Unitree Go2."""

    NAME, CHECKPOINT = "go2-walk", "builtin:go2-walk.onnx"
    JOINTS = tuple(f"{leg}_{joint}" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf"))
    DEFAULT_Q = np.array([-0.1, 0.9, -1.8, 0.1, 0.9, -1.8] * 2)
    GAINS = np.full(12, 40.0), np.full(12, 1.0)
    SCALE, ACTIONS = 0.5, 12
    FRAME = 9 + 2 * 12 + ACTIONS
    OBSERVATION = WalkPolicy.FRAMES * FRAME
    RANGE = ((-1.0, 1.0), (-0.6, 0.6), (-1.0, 1.0))


class G1WalkPolicy(WalkPolicy):
    """Of a Unitree G1 with 29 joints; its arms hang."""

    NAME, CHECKPOINT = "g1-walk", "builtin:g1-walk.onnx"
    JOINTS, SCALE, ACTIONS = G1_29, FalconPolicy.SCALE, _DRIVEN
    DEFAULT_Q = np.concatenate([FalconPolicy.DEFAULT_Q[:_DRIVEN], twist2.FORMAT.default[-len(G1_29) :][_DRIVEN:]])
    GAINS = tuple(
        np.concatenate([own[:_DRIVEN], arms[_DRIVEN:]])
        for own, arms in zip(FalconPolicy.GAINS, GrootWbcPolicy.GAINS, strict=True)
    )  # type: ignore[assignment]
    FRAME = 9 + 2 * len(G1_29) + ACTIONS
    OBSERVATION = WalkPolicy.FRAMES * FRAME
    RANGE = ((-0.5, 1.0), (-0.5, 0.5), (-1.0, 1.0))
