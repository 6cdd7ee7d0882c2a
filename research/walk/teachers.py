"""Teachers: policies of other projects on many robots at once, and what they would do where the student is."""

from __future__ import annotations

import numpy as np

from adapters.commands.g1_parts import VELOCITY_POSTURE
from adapters.policies.falcon import FalconPolicy
from adapters.policies.follower import gravity
from adapters.policies.playground import PlaygroundGo1Policy
from adapters.policies.walk.policy import Go2WalkPolicy
from research.collector import Histories
from research.crowd import States
from research.teacher import Network
from station.protocols import Floats, Floats32
from station.rotations import rotate_inverse


class Go1Teacher:
    """mujoco_playground's policy of the Go1, on a Go2: a body of the same build, which it walks as it is.

    Args:
        network: Its network.
    """

    _SDK = np.array([PlaygroundGo1Policy.JOINTS.index(name) for name in Go2WalkPolicy.JOINTS])
    """Of each joint of a Go2, its place among the teacher's; and back."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def __call__(self, states: States, commands: Floats, previous: Floats32) -> Floats32:
        """Return its outputs in the student's order, shape (n, 12).

        Args:
            states: Of n robots.
            commands: What it is asked for, shape (n, 3).
            previous: The outputs that were applied, shape (n, 12).
        """
        order = self._SDK
        velocity = rotate_inverse(states.quat_wxyz, states.lin_vel) + np.cross(states.gyro, PlaygroundGo1Policy.IMU)
        outputs = self._network(
            np.concatenate(
                [velocity, states.gyro, gravity(states), states.q[:, order] - PlaygroundGo1Policy.DEFAULT_Q,
                 states.dq[:, order], previous[:, order], commands], axis=1,
            )
        )  # fmt: skip
        return outputs[:, order]

    def forget(self, robot: int) -> None:
        """Nothing: it remembers nothing."""


class FalconTeacher:
    """FALCON's policy, of whose outputs the arms' are left out.

    Args:
        network: Its network.
        robots: How many.
    """

    HEIGHT_M = float(VELOCITY_POSTURE.default[3])

    def __init__(self, network: Network, robots: int) -> None:
        self._network = network
        self._seen = Histories(robots, FalconPolicy.FRAMES, FalconPolicy.FRAME)
        self._arms: Floats32 = np.zeros((robots, 14), dtype=np.float32)

    def __call__(self, states: States, commands: Floats, previous: Floats32) -> Floats32:
        """Return its outputs for legs and waist, shape (n, 15).

        Args:
            states: Of n robots.
            commands: What it is asked for: velocity and positions of the arms, shape (n, 17).
            previous: The outputs that were applied to legs and waist, shape (n, 15).
        """
        velocity, arms = commands[:, :3], commands[:, 3:]
        walks = velocity.any(axis=1, keepdims=True).astype(np.float64)
        height = np.full_like(walks, 2.0 * self.HEIGHT_M)
        self._seen.push(
            np.concatenate(
                [previous, self._arms, states.gyro * 0.25, velocity[:, 2:], height, velocity[:, :2], walks,
                 np.zeros_like(velocity), states.q - FalconPolicy.DEFAULT_Q, states.dq * 0.05, gravity(states), arms],
                axis=1,
            ).astype(np.float32)
        )  # fmt: skip
        outputs = self._network(self._seen.flat)
        self._arms = outputs[:, 15:]
        return outputs[:, :15]

    def forget(self, robot: int) -> None:
        """Begin anew with one robot."""
        self._seen.clear(robot)
        self._arms[robot] = 0.0
