"""The driver `body`: the robot does what the operator's whole body does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from adapters.commands.g1_walk_track import motion_of
from adapters.commands.twist2 import FORMAT
from adapters.drivers.body_on_legs import HEAD
from adapters.drivers.command_shaper import CommandShaper
from adapters.drivers.fingers import Fingers
from adapters.drivers.neck import SCALE, Neck
from adapters.retarget.arm_ik import ARMS
from adapters.robots.g1.joints import G1_29
from station.blends import times_to_standing
from station.bus.joints import SMPL_24
from station.errors import StationError
from station.operator import deltas
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import Body, OperatorSample, Pose
from station.protocols import Floats, Reference

LEAVE_S = 2.0
"""From where a body was let go to a stand [s]; the arms stay as they were, velocities fade sooner."""

_CHEST, _HEAD = SMPL_24.index("spine3"), SMPL_24.index("head")  # stock TWIST2 looks at these two for the neck
_WATCHED = ("pelvis", "head")  # what tells that the tracking jumped: hands and feet of a person are faster


class Retarget(Protocol):
    """What makes a robot's reference of an operator's body: `adapters.retarget.pipeline.BodyRetarget`."""

    joint_names: tuple[str, ...]

    def step(self, body: Body | None, capture_ns: int) -> Reference:
        """Return what the robot shall do; raises `StationError` for a body that cannot be."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of it: scaling, weights, latencies."""
        ...


class BodyDriver:
    """Implements `station.operator.driver.Driver`.

    Engaging blends from the command that stands to the live body over a second; letting go blends to a stand, because
    a foot may be in the air.

    Args:
        retarget: Calibrated for the operator.
        calibration: What a manifest says of that: whose, and the hash of its file.
        neck_scale: How far the neck turns for each radian of the head.
        robot: Part of a robot that takes motions, such as ``g1_29_track``; "" for the robot that TWIST2 knows.

    Attributes:
        command_format: TWIST2's numbers.
    """

    name = "body"
    mode = ""

    def __init__(
        self,
        retarget: Retarget,
        *,
        calibration: Mapping[str, Any] | None = None,
        neck_scale: float = SCALE,
        robot: str = "",
    ) -> None:
        self.command_format = motion_of(robot)
        self._retarget, self._calibration = retarget, dict(calibration or {})
        self._shaper, self._fingers, self._neck = CommandShaper(FORMAT), Fingers(), Neck(neck_scale)
        self._neck_scale = neck_scale
        self._held: Snapshot[Any, Any] | None = None
        self._rest = np.array(FORMAT.default)
        self._live: Floats | None = None
        self._why_not = ""
        self._left_s = 0.0

    @property
    def target(self) -> Floats:
        """The command that stands."""
        return self._shaper.sent.copy()

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Both Dex3 hands, and the neck; a part has neither."""
        if not self.command_format.auxiliary:
            return {}
        return {**FORMAT.auxiliary, **self._fingers.commands, **self._neck.command}

    @property
    def is_still(self) -> bool:
        """Whether the robot has come to a stand."""
        return self._held is None and self._left_s <= 0.0

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """A body is needed, at a time of the device."""
        if sample.body is None:
            return DriverInput(None, "the body is not tracked")
        if sample.capture_ns is None:
            return DriverInput(None, "the device does not say when it saw the body")
        return DriverInput(None, self._why_not) if self._why_not else DriverInput(sample.body)

    def jump(self, before: Body, now: Body) -> str:
        """Return what jumped, or ""."""
        return deltas.jump(_watched(before), _watched(now))

    def next_mode(self) -> str:
        """There is but one."""
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot the robot comes to a stand, arms as they are."""
        self._see(sample)
        if snapshot is not self._held:
            self._held = snapshot
            if snapshot is not None:
                self._shaper.begin()
            else:
                self._let_go()
        self._left_s = max(self._left_s - dt_s, 0.0) if snapshot is None else 0.0
        if snapshot is None or self._live is None:
            return self._shaper.send(self._rest, dt_s)
        if sample is not None:
            self._fingers.step(sample.controls, dt_s)
            if sample.body is not None:
                self._neck.follow(sample.body.quats_wxyz[_CHEST], sample.body.quats_wxyz[_HEAD], dt_s)
        return self._shaper.send(self._live, dt_s)

    def resume_from(self, command: Floats) -> None:
        """Continue from another writer's command; it holds until the operator engages."""
        self._shaper.resume_from(command)
        self._rest, self._left_s = self._shaper.sent.copy(), 0.0

    def facts(self) -> dict[str, Any]:
        """Return the name, whose calibration it goes by, and what the layers of the retargeting are set to."""
        calibration = {"calibration": self._calibration} if self._calibration else {}
        return {"driver": self.name, "neck_scale": self._neck_scale, **calibration, "retarget": self._retarget.facts()}

    def _see(self, sample: OperatorSample | None) -> None:
        """Retarget while the operator is not engaged as well: what is blended into must be under way already."""
        if sample is None or sample.body is None or sample.capture_ns is None:
            self._why_not = ""
            return
        try:
            reference = self._retarget.step(sample.body, sample.capture_ns)
        except StationError as error:  # told by the dead-man, which lets go
            self._why_not = str(error)
            return
        self._why_not = ""
        self._live = FORMAT.encode(reference, self._retarget.joint_names)

    def _let_go(self) -> None:
        self._rest = np.array(FORMAT.default)
        arms = [HEAD + G1_29.index(name) for name in ARMS]
        self._rest[arms] = self._shaper.sent[arms]
        self._left_s = LEAVE_S
        self._shaper.begin(times_to_standing(FORMAT, LEAVE_S))


def _watched(body: Body) -> dict[str, Pose]:
    return {
        name: Pose(body.positions[index], body.quats_wxyz[index])
        for name, index in ((name, SMPL_24.index(name)) for name in _WATCHED)
    }
