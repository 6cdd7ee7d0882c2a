"""The driver `hands`: palms follow the operator's hands, legs stand or walk by sticks, triggers and grips the fingers.

Palms move by differences from where they were at engaging, in the frame of the pelvis with the torso upright: they go
along with a walk and a squat.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec
import numpy as np

from adapters.commands.g1_walk_track import motion_of
from adapters.commands.twist2 import FORMAT
from adapters.drivers.body_on_legs import BodyOnLegs, named
from adapters.drivers.neck import SCALE, Neck
from adapters.retarget.arm_ik import SIDES, ArmIk
from station import rotations
from station.operator import deltas
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample, Pose, Side
from station.protocols import Floats

Poses = Mapping[str, Pose]
Palms = Mapping[Side, Pose]


class HandsOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the driver `hands`.

    Attributes:
        sides: The hands that drive.
        scale: How far a palm goes for each metre of a hand; a G1's arm reaches 0.45 m from its shoulder.
        heading: What is forward: ``world``, where the operator faced when the device was centred, or ``head``, where
            the headset faces at engaging.
        waist: Whether the waist helps the arms.
        neck_scale: How far the neck turns for each radian of the headset; 0 keeps it still.
        robot: Part of a robot that takes motions, such as ``g1_29_track``; "" for the robot that TWIST2 knows.
    """

    sides: tuple[Side, ...] = SIDES
    scale: float = 1.0
    heading: Literal["world", "head"] = "world"
    waist: bool = False
    neck_scale: float = SCALE
    robot: str = ""

    def __post_init__(self) -> None:
        if not self.sides or len(set(self.sides)) < len(self.sides):
            raise ValueError(f"sides is {list(self.sides)}; expected left, right, or both")
        if not 0.1 <= self.scale <= 3.0:
            raise ValueError(f"scale is {self.scale:g}; expected 0.1 to 3")
        if not 0.0 <= self.neck_scale <= 3.0:
            raise ValueError(f"neck_scale is {self.neck_scale:g}; expected 0 to 3 (stock TWIST2: {SCALE:g})")


class HandsDriver:
    """Implements `station.operator.driver.Driver`."""

    name = "hands"

    def __init__(self, options: HandsOptions | None = None) -> None:
        self._options = options or HandsOptions()
        self.command_format = motion_of(self._options.robot)
        self._body = BodyOnLegs()
        self._ik = ArmIk(waist=self._options.waist)
        self._neck = Neck(self._options.neck_scale)
        self._held: Snapshot[Poses, Palms] | None = None
        self._walks = False
        self.resume_from(FORMAT.default)

    @property
    def mode(self) -> str:
        """``stand``, where the sticks do nothing, or ``walk``."""
        return "walk" if self._walks else "stand"

    @property
    def target(self) -> Palms:
        """Where the palms are asked to be."""
        return self._ik.palms

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Both Dex3 hands, and the neck; a part has neither."""
        return {} if not self.command_format.auxiliary else {**self._body.auxiliary, **self._neck.command}

    @property
    def is_still(self) -> bool:
        """Whether the legs stand."""
        return self._body.is_standing

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """Both hands are needed, and the head where it tells what is forward."""
        found: dict[str, Pose | None] = {side: getattr(sample, side) for side in self._options.sides}
        if self._options.heading == "head":
            found["head"] = sample.head
        flaws = [f"{name} {why_not}" for name, pose in found.items() if (why_not := deltas.why_not(pose))]
        return DriverInput(None, "; ".join(flaws)) if flaws else DriverInput(found)

    def jump(self, before: Poses, now: Poses) -> str:
        """Return which hand jumped, or ""."""
        return deltas.jump(before, now)

    def next_mode(self) -> str:
        """Let the sticks drive the legs, or not."""
        self._walks = not self._walks
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot the arms stay and the legs come to a stand."""
        sticks, wish = self._body.sticks, self._body.sticks.rest()
        if snapshot is not self._held:  # engaged or let go in this tick: the arms stay where they are asked to be
            self._held = snapshot
            self._ik.reset(self._ik.q)
            if snapshot is not None:
                return self._body.begin()
        elif snapshot is not None and sample is not None:
            self._ik.step(self._goals(snapshot, sample), dt_s)
            self._body.fingers.step(sample.controls, dt_s)
            self._turn_neck(snapshot, sample, dt_s)
            if self._walks:
                wish = sticks.wish(sample.controls, dt_s)
        return self._body.send(wish, dt_s, named(self._ik.joint_names, self._ik.q))

    def resume_from(self, command: Floats) -> None:
        """Start from a command that another writer gave, shape (m,)."""
        self._body.resume_from(command)
        self._ik.reset(self._body.joints(self._ik.joint_names))

    def facts(self) -> dict[str, Any]:
        """Name and options."""
        return {"driver": self.name, **msgspec.to_builtins(self._options)}

    def _turn_neck(self, snapshot: Snapshot[Poses, Palms], sample: OperatorSample, dt_s: float) -> None:
        """Turn the neck as far as the headset is turned away from forward; without a headset the neck stays."""
        if sample.head is None or deltas.why_not(sample.head):
            return
        forward = rotations.from_rotation_vector(np.array([0.0, 0.0, self._heading_rad(snapshot)]))
        self._neck.follow(forward, sample.head.quat_wxyz, dt_s)

    def _heading_rad(self, snapshot: Snapshot[Poses, Palms]) -> float:
        if self._options.heading == "world":
            return 0.0
        return float(rotations.roll_pitch_yaw(snapshot.start["head"].quat_wxyz)[2])

    def _goals(self, snapshot: Snapshot[Poses, Palms], sample: OperatorSample) -> dict[Side, Pose]:
        heading = self._heading_rad(snapshot)
        goals: dict[Side, Pose] = {side: snapshot.target[side] for side in SIDES}
        for side in self._options.sides:
            now: Pose = getattr(sample, side)
            goals[side] = deltas.followed(
                snapshot.target[side], snapshot.start[side], now, scale=self._options.scale, heading_rad=heading
            )
        return goals
