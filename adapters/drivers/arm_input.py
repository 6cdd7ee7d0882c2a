"""What an operator's device asks of an arm: a leader's joints, a hand, a twist, or sticks and keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from adapters.drivers.sticks import live, summed
from station.operator import deltas
from station.operator.sample import OperatorSample, Pose, Side
from station.protocols import Floats

Kind = Literal["leader", "hand", "twist", "controls"]

LEADER_JUMP_RAD = 0.8
"""Between two samples; a servo that restarts comes back a turn off [rad]."""

_FORWARD = {"left_stick_y": 1.0, "key_w": 1.0, "key_s": -1.0}
_LEFT = {"left_stick_x": -1.0, "key_a": 1.0, "key_d": -1.0}
_UP = {"right_stick_y": 1.0, "key_page_up": 1.0, "key_page_down": -1.0}
_ROLL_RIGHT = {"dpad_right": 1.0, "dpad_left": -1.0, "key_period": 1.0, "key_comma": -1.0}
_PITCH_DOWN = {"dpad_down": 1.0, "dpad_up": -1.0, "key_k": 1.0, "key_i": -1.0}
_TURN_LEFT = {"right_stick_x": -1.0, "key_j": 1.0, "key_l": -1.0}
_TOOL = (_FORWARD, _LEFT, _UP, _ROLL_RIGHT, _PITCH_DOWN, _TURN_LEFT)

_JOG = {"left_stick_y": 1.0, "dpad_up": 1.0, "dpad_down": -1.0, "key_up": 1.0, "key_down": -1.0}
_NEXT = {"right_stick_x": 1.0, "dpad_right": 1.0, "dpad_left": -1.0, "key_right": 1.0, "key_left": -1.0}
_CHOSEN = 0.5  # of a stick's way: beyond it the next joint is meant


@dataclass(frozen=True, slots=True, eq=False)
class ArmInput:
    """What a sample asks of an arm, and by which of its parts.

    Attributes:
        kind: The part that drives.
        is_tool: Whether it drives the tool, and not joints.
        joints: Of a leader, shape (n,) [rad].
        poses: The hand by its side, and the head under ``head`` where it tells what is forward.
    """

    kind: Kind
    is_tool: bool = False
    joints: Floats | None = None
    poses: Mapping[str, Pose] | None = None


def of(sample: OperatorSample, hand: Side, *, joints: int, needs_head: bool, is_tool: bool) -> ArmInput | str:
    """Return what a sample asks of an arm, or what it lacks.

    Args:
        sample: The sample.
        hand: The hand that may drive.
        joints: How many the arm has.
        needs_head: Whether the headset tells what is forward.
        is_tool: Whether the tool is driven, and not joints.
    """
    if sample.joints is not None:
        return (
            "a leader arm drives joints and not the tool; change the mode"
            if is_tool
            else _leader(sample.joints, joints)
        )
    if is_tool and (sample.left is not None or sample.right is not None or sample.head is not None):
        return _hand(sample, hand, needs_head=needs_head)
    if sample.twist is not None:
        return ArmInput("twist", is_tool) if np.isfinite(sample.twist).all() else "the device sends no numbers"
    return ArmInput("controls", is_tool) if sample.controls else "the device sends nothing that moves an arm"


def jump(before: ArmInput, now: ArmInput, joint_names: Sequence[str]) -> str:
    """Return what jumped between two samples, or ""; what drives in another mode is counted from there."""
    if before.is_tool != now.is_tool:
        return ""
    if before.kind != now.kind:
        return f"the device sends {now.kind} and no {before.kind} any more"
    if before.joints is not None and now.joints is not None:
        change = np.abs(now.joints - before.joints)
        worst = int(change.argmax())
        if change[worst] > LEADER_JUMP_RAD:
            limit = f"(limit {LEADER_JUMP_RAD:g})"
            return f"{joint_names[worst]} of the leader jumped {change[worst]:.2f} rad between two samples {limit}"
    return deltas.jump(before.poses, now.poses) if before.poses and now.poses else ""


def tool_deflection(sample: OperatorSample) -> Floats:
    """Return what a twist, or else sticks and keys ask of the tool: vx vy vz wx wy wz, -1 to 1, shape (6,)."""
    if sample.twist is not None:
        return np.clip(sample.twist, -1.0, 1.0)
    return np.array([live(summed(sample.controls, signs)) for signs in _TOOL])


def jog(controls: Mapping[str, float]) -> float:
    """Return how fast sticks and keys turn the chosen joint, -1 to 1."""
    return live(summed(controls, _JOG))


class Choice:
    """Which joint sticks and keys turn: a digit chooses it, arrows and a stick to the side go to the next.

    Args:
        joints: How many there are.

    Attributes:
        joint: Index of the joint, from 0.
    """

    def __init__(self, joints: int) -> None:
        self.joint, self._joints = 0, joints
        self._was = 0.0  # where the stick stood: what is held was counted

    def step(self, controls: Mapping[str, float]) -> None:
        """Read the controls."""
        for index in range(self._joints):
            if controls.get(f"key_{index + 1}", 0.0) > _CHOSEN:
                self.joint = index
        way = summed(controls, _NEXT)
        if abs(way) > _CHOSEN >= abs(self._was):
            self.joint = (self.joint + (1 if way > 0.0 else -1)) % self._joints
        self._was = way


def _leader(joints: Floats, count: int) -> ArmInput | str:
    if len(joints) not in (count, count + 1) or not np.isfinite(joints).all():  # the last one is a gripper's
        return f"the leader sends {len(joints)} values, expected {count} joints, and a gripper or none"
    return ArmInput("leader", joints=joints[:count])


def _hand(sample: OperatorSample, hand: Side, *, needs_head: bool) -> ArmInput | str:
    found: dict[str, Pose | None] = {hand: sample.left if hand == "left" else sample.right}
    if needs_head:
        found["head"] = sample.head
    flaws = [f"{name} {why_not}" for name, pose in found.items() if (why_not := deltas.why_not(pose))]
    return (
        "; ".join(flaws) if flaws else ArmInput("hand", True, poses={n: p for n, p in found.items() if p is not None})
    )
