"""What teacher and student see, for many robots at once: the same numbers as the policies themselves make."""

from __future__ import annotations

import numpy as np

from adapters.policies.twist2 import ANKLES, DEFAULT_Q, FRAME, GYRO_SCALE, VELOCITY_SCALE
from research.crowd import States
from station.protocols import Floats, Floats32
from station.rotations import roll_pitch_yaw

NOISE_AT = (slice(40, 69), slice(69, 98), slice(35, 38), slice(38, 40))  # joints, joint speeds, gyro, tilt


def frames(states: States, commands: Floats, actions: Floats32) -> Floats32:
    """Return the frames of one step, shape (n, 127).

    Args:
        states: Of n robots.
        commands: Shape (n, 35).
        actions: Previous raw outputs, shape (n, 29).
    """
    out = np.empty((len(commands), FRAME), dtype=np.float32)
    out[:, :35] = commands
    out[:, 35:38] = states.gyro * GYRO_SCALE
    out[:, 38:40] = roll_pitch_yaw(states.quat_wxyz)[:, :2]
    out[:, 40:69] = states.q - DEFAULT_Q
    out[:, 69:98] = states.dq * VELOCITY_SCALE
    out[:, 69 + ANKLES] = 0.0
    out[:, 98:127] = actions
    return out


def noise_scales(amounts: tuple[float, float, float, float]) -> Floats32:
    """Return the amplitude of sensor noise of each number of a frame, shape (127,), in the frame's own scale."""
    scales = np.zeros(FRAME, dtype=np.float32)
    for where, amount, factor in zip(NOISE_AT, amounts, (1.0, VELOCITY_SCALE, GYRO_SCALE, 1.0), strict=True):
        scales[where] = amount * factor
    return scales
