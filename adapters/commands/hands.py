"""Commands of hands and a neck that are robots of their own: as TWIST2's programs command them, and Inspire's.

| format | key | joints |
|---|---|---|
| `twist2-left-hand`, `twist2-right-hand` | ``action_hand_left_unitree_g1_with_hands``, … | 7 |
| `twist2-neck` | ``action_neck_unitree_g1_with_hands`` | 2 |
| `inspire-left-hand`, `inspire-right-hand` | ``action_joints_inspire_left_hand``, … | 6 |
| `inspire-hands` | those two, each with its own gate: an RH56DFX's hands share their messages | 12 |
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np

from adapters.commands import g1_parts
from adapters.commands.hand import HandCommand, Side
from adapters.robots.g1 import twist_keys
from adapters.robots.hands import inspire
from station.arms import JointCommand
from station.parts import PartedCommand

NECK = ("neck_yaw", "neck_pitch")
LIMIT_RAD = math.pi / 2
"""Neither joint of a neck is asked to go farther to either side; stock asks for anything."""

RATE_RAD_S = 3.0
"""Nor faster."""

_NECK_BEYOND_RAD = 3.0  # stock turns it 1.5 times as far as a head, which is clamped
_BEYOND_RAD = 0.2  # outside its range a target is still clamped so far; farther away it is another hand's, or a fault


def _twist2(side: Side) -> HandCommand:
    key = twist_keys.action_hand(side)
    return g1_parts.hand(side, twist_keys.TWIST2_ROBOT, name=f"twist2-{side}-hand", stock_key=key)


def _inspire(side: Side) -> HandCommand:
    joints = inspire.JOINTS[side]
    lower, upper, rate = (
        np.array([getattr(joint, field) for joint in joints]) for field in ("lower", "upper", "velocity_rad_s")
    )
    bare = JointCommand.within(
        f"inspire-{side}-hand", f"inspire_{side}_hand", tuple(joint.name for joint in joints), lower=lower, upper=upper,
        margin=np.full(len(joints), _BEYOND_RAD), rate=rate,
    )  # fmt: skip
    return HandCommand(
        **{field.name: getattr(bare, field.name) for field in fields(bare)},
        side=side, fingers=tuple(inspire.BENT_BY.values()), opened=bare.lower, closed=bare.upper,
    )  # fmt: skip


def _neck() -> JointCommand:
    ends = np.full(len(NECK), LIMIT_RAD)
    return JointCommand.within(
        "twist2-neck", f"{twist_keys.TWIST2_ROBOT}_neck", NECK, lower=-ends, upper=ends,
        margin=np.full(len(NECK), _NECK_BEYOND_RAD), rate=np.full(len(NECK), RATE_RAD_S),
        stock_key=twist_keys.action_neck(), awaits_pause=False,
    )  # fmt: skip


TWIST2_NECK = _neck()
TWIST2_LEFT, TWIST2_RIGHT = _twist2("left"), _twist2("right")
INSPIRE_LEFT, INSPIRE_RIGHT = _inspire("left"), _inspire("right")
INSPIRE_BOTH = PartedCommand("inspire-hands", "inspire", [INSPIRE_LEFT, INSPIRE_RIGHT])
