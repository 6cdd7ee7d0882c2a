"""What a G1's server puts on the bus at the start of a tick for stock programs: the keys of TWIST or TWIST2.

Byte for byte what stock readers expect, but for one thing: no vector of zeros goes before the first real state.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np

from adapters.robots.g1 import twist_keys
from station.bus import codec
from station.protocols import Floats32, RobotState
from station.rotations import roll_pitch_yaw

_HAND = codec.json_vector([0.0] * 7)
_NO_HANDS = {
    twist_keys.TWIST2_ROBOT: {
        twist_keys.state_hand("left"): _HAND,
        twist_keys.state_hand("right"): _HAND,
        twist_keys.state_neck(): codec.json_vector([0.0] * 2),
    },
    twist_keys.TWIST_ROBOT: {twist_keys.state_hands(): codec.json_vector([0.0] * 14)},
}


@runtime_checkable
class Proprioceptive(Protocol):
    """A policy that shows its scaled view of the robot: TWIST's, whose stock server publishes it as the state."""

    def proprioception(self, state: RobotState) -> Floats32:
        """Return the scaled proprioception of the step to come."""
        ...


def stock_values(state: RobotState, policy: object, name: str) -> Mapping[str, bytes]:
    """Return the values of a robot without hands by key: open, and still, as the stock simulation says.

    Args:
        state: Of the 29 joints.
        policy: For TWIST, the policy in use.
        name: Suffix of the robot's keys; decides which stock keys there are.
    """
    body = body_values(state, policy, name)
    return {**body, **_NO_HANDS[name]} if body else {}


def body_values(state: RobotState, policy: object, name: str) -> Mapping[str, bytes]:
    """Return those of the body alone: of a real robot the servers of its hands and its neck tell of those."""
    if name == twist_keys.TWIST2_ROBOT:
        body = np.concatenate([state.gyro, roll_pitch_yaw(state.quat_wxyz)[:2], state.q])
        now_ms = time.time_ns() // 1_000_000
        return {twist_keys.state_body(name): codec.json_vector(body), twist_keys.T_STATE: b"%d" % now_ms}
    if name == twist_keys.TWIST_ROBOT and isinstance(policy, Proprioceptive):
        return {twist_keys.state_body(name): codec.json_vector(policy.proprioception(state))}
    return {}
