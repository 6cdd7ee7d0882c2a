"""A robot that nothing of ours knows: two legs with a joint each. What its server would state, write and be told."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from station.bus import codec, keys
from station.bus.robot_streams import driven_by_policy
from station.contract import Contract, elements
from station.description import ROBOT, Joint, RobotDescription
from station.protocols import Floats

NAME = "strider"
KNEES = ("left_knee", "right_knee")
COMMAND = (*elements((("speed",), "m/s")), *elements((("left_knee_pos", "right_knee_pos"), "rad")))
FEET = "state_feet_strider"

DESCRIPTION = RobotDescription(
    name=NAME,
    model="strider",
    joints=tuple(Joint(name, lower=-1.0, upper=1.5, speed=8.0) for name in KNEES),
    groups={"left leg": KNEES[:1], "right leg": KNEES[1:]},
    has_base=True,
    streams=(
        Contract(key=f"action_walk_{ROBOT}", family="strider", role="command", codec="json-vector", elements=COMMAND),
        Contract(key=f"state_feet_{ROBOT}", family="strider", role="state", codec="json-vector",
                 elements=elements((("left_force", "right_force"), "N")), rate_hz=50.0),
        *driven_by_policy(COMMAND),
    ),
)  # fmt: skip


def facts(**more: Any) -> dict[str, Any]:
    """What its server states."""
    described = msgspec.to_builtins(DESCRIPTION)
    return {"server": "walker", "role": "low-level", "robot": NAME, "description": described, **more}


def state(q: Floats, *, dq: ArrayLike = (0.0, 0.0), upright: bool = True) -> bytes:
    """A value of its `keys.robot_state`."""
    quat = [1.0, 0.0, 0.0, 0.0] if upright else [0.0, 1.0, 0.0, 0.0]
    return codec.f64(np.concatenate([q, dq, quat, np.zeros(3)]))


def step(number: int, q: Floats) -> dict[str, bytes]:
    """What its server writes at the end of a step in which it was asked for joints."""
    return {
        keys.policy_obs(NAME): codec.f32(np.zeros(4)),
        keys.policy_action(NAME): codec.f32(np.zeros(2)),
        keys.policy_timing(NAME): codec.json_vector([number, number, *range(10**9, 10**9 + 6)]),
        keys.command_gate(NAME): codec.json_object({"state": "tracking", "reason": ""}),
        keys.command_used(NAME): codec.f64(np.concatenate([[0.4], q])),
        keys.target(NAME): codec.f64(np.concatenate([q, np.full(2, 40.0), np.ones(2)])),
    }
