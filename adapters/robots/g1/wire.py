"""What a G1 server puts on the bus at the start of a tick: the keys of TWIST or TWIST2, and the station's own.

Byte for byte what stock readers expect, but for one thing: no vector of zeros goes before the first real state.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.protocols import Floats, Floats32, RobotState
from station.rotations import roll_pitch_yaw

_HAND = codec.json_vector([0.0] * 7)
_BOTH_HANDS = codec.json_vector([0.0] * 14)
_NECK = codec.json_vector([0.0] * 2)


@runtime_checkable
class Proprioceptive(Protocol):
    """A policy that shows its scaled view of the robot: TWIST's, whose stock server publishes it as the state."""

    def proprioception(self, state: RobotState) -> Floats32:
        """Return the scaled proprioception of the step to come."""
        ...


@runtime_checkable
class Simulated(Protocol):
    """A robot that knows the truth."""

    @property
    def qpos(self) -> Floats:
        """Root position, root quaternion wxyz, joints."""
        ...


def state_values(suffix: str, state: RobotState, *, policy: object, robot: object) -> Mapping[str, bytes]:
    """Return the values by key.

    Args:
        suffix: Robot suffix of the keys; decides which stock keys there are.
        state: Of the 29 joints.
        policy: For TWIST, the policy in use.
        robot: For ground truth, where it has any.
    """
    values = {keys.robot_state(suffix): codec.f64(np.concatenate([state.q, state.dq, state.quat_wxyz, state.gyro]))}
    if suffix == twist_keys.TWIST2_ROBOT:
        values |= _twist2(suffix, state)
    elif suffix == twist_keys.TWIST_ROBOT and isinstance(policy, Proprioceptive):
        values[twist_keys.state_body(suffix)] = codec.json_vector(policy.proprioception(state))
        values[twist_keys.state_hands(suffix)] = _BOTH_HANDS
    if isinstance(robot, Simulated):
        values[keys.sim_qpos(suffix)] = codec.f64(robot.qpos)
    return values


def _twist2(suffix: str, state: RobotState) -> dict[str, bytes]:
    body = np.concatenate([state.gyro, roll_pitch_yaw(state.quat_wxyz)[:2], state.q])
    return {
        twist_keys.state_body(suffix): codec.json_vector(body),
        twist_keys.state_hand("left", suffix): _HAND,  # no hands in this model: open, as the stock simulation says
        twist_keys.state_hand("right", suffix): _HAND,
        twist_keys.state_neck(suffix): _NECK,
        twist_keys.T_STATE: b"%d" % (time.time_ns() // 1_000_000),
    }
