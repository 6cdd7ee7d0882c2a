"""Operators made of numbers, for every driver: what each sees at a time, and a robot's body for the whole-body one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.drivers.body import BodyDriver
from adapters.drivers.hands import HandsDriver
from adapters.drivers.jog import JogDriver
from adapters.drivers.joints import JointsDriver
from adapters.drivers.walk import WalkDriver
from adapters.retarget.walking import VelocityCommand, Walker
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.operator.driver import Driver
from station.operator.sample import Body, OperatorSample, Pose
from station.protocols import Reference

TICK_S = 0.01

Operator = Callable[[float], OperatorSample]
"""From a time [s] to a sample."""


class Shadow:
    """In place of retargeting: a robot that squats when the operator's pelvis goes down."""

    joint_names = G1_29

    def __init__(self) -> None:
        self._walker = Walker()

    def step(self, body: Body | None, capture_ns: int) -> Reference:
        """Follow the height of the pelvis."""
        assert body is not None
        return self._walker.step(TICK_S, VelocityCommand(height=float(body.positions[0, 2])))

    def facts(self) -> dict[str, Any]:
        """Nothing but the name."""
        return {"retarget": "shadow"}


def hand(time_s: float, side: str) -> Pose:
    """A hand that swings about."""
    mirror = 1.0 if side == "left" else -1.0
    way = 0.06 * np.array([np.sin(2.0 * time_s), mirror * np.sin(3.0 * time_s), np.cos(1.3 * time_s)])
    turn = rotations.from_rotation_vector(0.2 * np.array([np.sin(time_s), np.cos(1.7 * time_s), 0.3]))
    return Pose(np.array([0.3, mirror * 0.2, 1.1]) + way, turn)


def hands(time_s: float) -> OperatorSample:
    """An operator with two controllers."""
    controls = {"left_stick_y": 0.8, "right_stick_x": -0.5, "right_trigger": 1.0}
    return OperatorSample(capture_ns=1, controls=controls, left=hand(time_s, "left"), right=hand(time_s, "right"))


def sticks(time_s: float) -> OperatorSample:
    """An operator with a gamepad."""
    return OperatorSample(
        capture_ns=1, controls={"left_stick_y": np.sin(time_s), "right_stick_x": 0.5, "left_grip": 0.0}
    )


def twist(time_s: float) -> OperatorSample:
    """An operator with a six-axis knob."""
    return OperatorSample(controls={"button_0": 0.0}, twist=np.sin(time_s + np.arange(6.0)))


def leader(time_s: float) -> OperatorSample:
    """An operator with a leader arm that begins where the robot's left arm stands."""
    joints = np.array(FORMAT.default[21:28]) + 0.3 * np.sin(time_s + np.arange(7.0))
    return OperatorSample(controls={"button_0": 0.0}, joints=joints)


def body(time_s: float) -> OperatorSample:
    """An operator who squats."""
    positions, quats = np.zeros((24, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (24, 1))
    positions[:, 2] = 0.7 + 0.06 * np.sin(time_s)
    return OperatorSample(capture_ns=int(time_s * 1e9), controls={"right_trigger": 1.0}, body=Body(positions, quats))


DRIVERS: dict[str, tuple[Callable[[], Driver], Operator]] = {
    "hands": (HandsDriver, hands),
    "walk": (WalkDriver, sticks),
    "jog": (JogDriver, twist),
    "joints": (JointsDriver, leader),
    "body": (lambda: BodyDriver(Shadow()), body),
}
