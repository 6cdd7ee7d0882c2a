"""What a policy that follows 35 numbers is fed in tests: states near the default pose, and commands."""

from __future__ import annotations

import numpy as np

from adapters.policies.twist2 import DEFAULT_Q
from station.protocols import Floats, RobotState
from station.rotations import normalized


def inputs(count: int, seed: int = 0) -> list[tuple[RobotState, Floats]]:
    """Return states and commands, shape (35,) each, drawn at random."""
    random = np.random.default_rng(seed)

    def state() -> RobotState:
        return RobotState(
            mono_ns=0,
            q=DEFAULT_Q + random.normal(size=29) * 0.1,
            dq=random.normal(size=29),
            quat_wxyz=normalized(np.array([1.0, 0, 0, 0]) + random.normal(size=4) * 0.1),
            gyro=random.normal(size=3),
        )

    return [(state(), random.normal(size=35) * 0.2) for _ in range(count)]
