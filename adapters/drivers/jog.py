"""The driver `jog`: a six-axis twist moves one palm, the other, or the legs; the mode says which."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.drivers.body_on_legs import BodyOnLegs, named
from adapters.retarget.arm_ik import SIDES, ArmIk
from station import rotations
from station.operator import deltas
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample, Pose, Side
from station.protocols import CommandFormat, Floats

MODES: tuple[str, ...] = (*SIDES, "walk")

PALM_MPS, PALM_RAD_S = 0.25, 0.8
"""Speeds of a palm at full deflection [m/s, rad/s]."""

_LEAD_M, _LEAD_RAD = 0.05, 0.3  # a goal goes no farther ahead of a palm that cannot follow


class JogDriver:
    """Implements `station.operator.driver.Driver`; begins with the right palm."""

    name = "jog"

    def __init__(self) -> None:
        self._body, self._ik = BodyOnLegs(), ArmIk()
        self._held: Snapshot[Any, Any] | None = None
        self._mode = MODES.index("right")
        self._goals = self._ik.palms
        self.resume_from(FORMAT.default)

    @property
    def command_format(self) -> CommandFormat:
        """TWIST2's."""
        return FORMAT

    @property
    def mode(self) -> str:
        """``left`` or ``right`` palm, or ``walk``."""
        return MODES[self._mode]

    @property
    def target(self) -> Mapping[Side, Pose]:
        """Where the palms are asked to be."""
        return self._ik.palms

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Both Dex3 hands, and the neck at rest."""
        return self._body.auxiliary

    @property
    def is_still(self) -> bool:
        """Whether the legs stand."""
        return self._body.is_standing

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """A twist is needed."""
        if sample.twist is None or not np.isfinite(sample.twist).all():
            return DriverInput(None, "the device sends no twist")
        return DriverInput(sample.twist)

    def jump(self, before: Any, now: Any) -> str:
        """A twist may change as it likes."""
        return ""

    def next_mode(self) -> str:
        """Go from palm to palm to walking; what moved before stays."""
        self._mode = (self._mode + 1) % len(MODES)
        self._goals = self._ik.palms
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot everything comes to rest."""
        sticks, wish = self._body.sticks, self._body.sticks.rest()
        if snapshot is not self._held:
            self._held = snapshot
            self._ik.reset(self._ik.q)
            self._goals = self._ik.palms
            if snapshot is not None:
                return self._body.begin()
        elif snapshot is not None and sample is not None and sample.twist is not None:
            twist = np.clip(sample.twist, -1.0, 1.0)
            if self.mode == "walk":
                wish = sticks.deflected(twist[0], twist[1], twist[5], twist[2], dt_s)
            else:
                side = SIDES[self._mode]
                self._goals[side] = _led(_moved(self._goals[side], twist, dt_s), self._ik.palms[side])
            self._ik.step(self._goals, dt_s)
            self._body.fingers.step(sample.controls, dt_s)
        return self._body.send(wish, dt_s, named(self._ik.joint_names, self._ik.q))

    def resume_from(self, command: Floats) -> None:
        """Start from a command that another writer gave, shape (m,)."""
        self._body.resume_from(command)
        self._ik.reset(self._body.joints(self._ik.joint_names))
        self._goals = self._ik.palms

    def facts(self) -> dict[str, Any]:
        """Return name and modes."""
        return {"driver": self.name, "modes": list(MODES)}


def _moved(pose: Pose, twist: Floats, dt_s: float) -> Pose:
    """Move a pose along and about the axes of the pelvis."""
    turn = rotations.from_rotation_vector(twist[3:] * PALM_RAD_S * dt_s)
    quat = rotations.normalized(rotations.multiply(turn, pose.quat_wxyz))
    return Pose(pose.position + twist[:3] * PALM_MPS * dt_s, quat)


def _led(goal: Pose, palm: Pose) -> Pose:
    """Keep a goal near the palm, so that turning back acts at once."""
    way = goal.position - palm.position
    distance = float(np.linalg.norm(way))
    position = palm.position + way * min(1.0, _LEAD_M / max(distance, 1e-9))
    angle = deltas.angle_between(palm.quat_wxyz, goal.quat_wxyz)
    part = min(1.0, _LEAD_RAD / max(angle, 1e-9))
    return Pose(position, rotations.slerp(palm.quat_wxyz, goal.quat_wxyz, np.array(part)))
