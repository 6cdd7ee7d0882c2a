"""mujoco_playground's joystick policies of the 29-joint G1 and the Go1: ONNX; they need the velocity of the base.

G1 (103): 0 velocity (3) and 3 angular velocity (3) of the IMU's place, in the root frame · 6 gravity (3) · 9 vx, vy,
yaw rate of the command (3) · 12 q - default (29) · 41 dq (29) · 70 previous output (29) · 99 cosine, then sine of the
phase of left and right foot (4). The phase of the left begins at 0, goes on after each inference, 1.5 times round in a
second, also at a command of zero; the right is half a turn ahead.

Go1 (48): the first nine as above, of its own IMU · 9 q - default (12) · 21 dq (12) · 33 previous output (12) · 45 the
command (3). Nothing is scaled. Wire facts: google-deepmind/mujoco_playground, ``experimental/sim2sim``.
"""

from __future__ import annotations

import numpy as np

from adapters.policies.follower import VelocityFollower, gravity, joined
from adapters.robots.g1.joints import G1_29
from station.protocols import Floats, Floats32, RobotState

_ORIGIN = "google-deepmind/mujoco_playground on GitHub (Apache-2.0), mujoco_playground/experimental/sim2sim/onnx/{}"
_CYCLE, _TURNS = 100, 3
"""The phase is where it was after 100 steps of 20 ms, in which it goes round three times."""
_BACK = 67
"""A step is 67 times the hundredths of a turn that it shows, since 3 x 67 = 201."""
_LEG = (-0.312, 0.0, 0.0, 0.669, -0.363, 0.0)


class PlaygroundPolicy(VelocityFollower):
    """`station.protocols.Policy` of the family."""

    SCALE = 0.5
    NEEDS_ROOT_VELOCITY = True
    IMU: Floats
    """Place of the IMU in the root frame [m]."""

    def _moves(self, state: RobotState) -> Floats:
        """Return how the base moves, shape (9,): velocity and angular velocity of the IMU's place, and gravity."""
        assert state.root_lin_vel is not None, "the rig gives it no robot that does not measure it"
        return np.concatenate([state.root_lin_vel + np.cross(state.gyro, self.IMU), state.gyro, gravity(state)])


class PlaygroundG1Policy(PlaygroundPolicy):
    """Of the G1."""

    NAME, ORIGIN = "playground-g1", _ORIGIN.format("g1_policy.onnx")
    JOINTS, OBSERVATION = G1_29, 103
    DEFAULT_Q = np.array([*_LEG, *_LEG, 0, 0, 0.073, 0.2, 0.2, 0, 0.6, 0, 0, 0, 0.2, -0.2, 0, 0.6, 0, 0, 0], np.float64)
    GAINS = (
        np.array([75.0, 75, 75, 75, 20, 2] * 2 + [75] * 3 + ([75] * 4 + [2] * 3) * 2),
        np.array([2.0, 2, 2, 2, 1, 0.2] * 2 + [2] * 3 + ([2] * 4 + [0.2] * 3) * 2),
    )
    RANGE = ((-1.0, 1.0), (-0.5, 0.5), (-1.0, 1.0))
    IMU = np.array([0.04525, 0.0, -0.08339])

    def reset(self) -> None:
        """Forget the previous output and the phase."""
        super().reset()
        self._step = 0

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (103,), of the state of the 29 joints and a velocity, shape (3,)."""
        previous, left = self._previous(), self._step * _TURNS % _CYCLE / _CYCLE
        phase = 2 * np.pi * np.array([left, left + 0.5])
        self._step = (self._step + 1) % _CYCLE
        return joined(
            self._moves(state), command, state.q - self.DEFAULT_Q, state.dq, previous, np.cos(phase), np.sin(phase)
        )

    def restore(self, observation: Floats32) -> None:
        """Restore previous output and phase from a recorded observation, shape (103,)."""
        super().restore(observation)
        turns = np.arctan2(float(observation[101]), float(observation[99])) / (2 * np.pi)
        self._step = (round(turns * _CYCLE) * _BACK + 1) % _CYCLE


class PlaygroundGo1Policy(PlaygroundPolicy):
    """Of the Go1."""

    NAME, ORIGIN = "playground-go1", _ORIGIN.format("go1_policy.onnx")
    JOINTS = tuple(f"{leg}_{joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf"))
    OBSERVATION = 48
    DEFAULT_Q = np.array([0.1, 0.9, -1.8, -0.1, 0.9, -1.8] * 2)
    GAINS = np.full(12, 35.0), np.full(12, 0.5)
    RANGE = ((-1.5, 1.5), (-0.8, 0.8), (-1.2, 1.2))
    IMU = np.array([-0.01592, -0.06659, -0.00617])

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation, shape (48,), of the state of the 12 joints and a velocity, shape (3,)."""
        return joined(self._moves(state), state.q - self.DEFAULT_Q, state.dq, self._previous(), command)
