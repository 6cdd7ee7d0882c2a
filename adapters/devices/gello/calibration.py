"""What turns the servos of one leader arm into the joints of its follower, kept by the leader's serial number.

    joint = (servo - offset) · sign            gripper = (servo - open) / (closed - open), 0 open to 1 closed

The horns of the servos have four positions, so offsets are quarter turns. A servo without power forgets how many turns
it has made: after each start the joints are brought to the turn nearest to a stored reference.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from adapters.devices import calibration_file
from adapters.devices.gello.bus import model_name
from station.errors import BadFile
from station.operator.device import DeviceError
from station.protocols import Floats

Arm = Literal["left", "right"]

QUARTER = math.pi / 2.0
MOST_QUARTERS = 16
"""Offsets are looked for within this many quarter turns of zero."""

LEAST_TRAVEL_RAD = math.radians(10.0)
"""A gripper that moves less between open and closed has not been moved."""

_TURN = 2.0 * math.pi
_MOST_SERVOS = 32


class JointCalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One joint.

    Attributes:
        id: Number of its servo on the bus.
        name: Of the follower's joint.
        model: Model number of the servo.
        offset_rad: What the servo shows where the joint is at zero [rad]; a multiple of a quarter turn.
        sign: 1, or -1 where the servo turns against the joint.
        reference_rad: Joint position that the first one after a start is at most half a turn away from [rad].
    """

    id: int
    name: str
    model: int
    offset_rad: float
    sign: int
    reference_rad: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.id <= 252:
            raise ValueError(f"id is {self.id}; expected 0 to 252")
        if self.sign not in (1, -1):
            raise ValueError(f"sign is {self.sign}; expected 1 or -1")
        if not (math.isfinite(self.offset_rad) and math.isfinite(self.reference_rad)):
            raise ValueError(f"offset_rad and reference_rad of servo {self.id} must be finite")


class GripperCalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The gripper's trigger.

    Attributes:
        id: Number of its servo on the bus.
        model: Model number of the servo.
        open_rad, closed_rad: What the servo shows when it is fully open and fully closed [rad].
    """

    id: int
    model: int
    open_rad: float
    closed_rad: float

    def __post_init__(self) -> None:
        if not 0 <= self.id <= 252:
            raise ValueError(f"id is {self.id}; expected 0 to 252")
        if not abs(self.closed_rad - self.open_rad) >= LEAST_TRAVEL_RAD:
            raise ValueError(f"the gripper moves less than {math.degrees(LEAST_TRAVEL_RAD):g}° from open to closed")


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of one leader arm.

    Attributes:
        serial: Serial number of its USB adapter.
        arm: Which arm of the follower it leads.
        date: Day of the calibration, ``2026-11-21``.
        joints: In the order of the follower.
        gripper: None for a leader without one.
    """

    serial: str
    arm: Arm
    date: str
    joints: tuple[JointCalibration, ...]
    gripper: GripperCalibration | None = None

    def __post_init__(self) -> None:
        if not 1 <= len(self.ids) <= _MOST_SERVOS or not self.joints:
            raise ValueError(f"{len(self.ids)} servos; expected 1 to {_MOST_SERVOS}, one of them a joint")
        if len(set(self.ids)) < len(self.ids):
            raise ValueError(f"an id comes twice among {', '.join(map(str, self.ids))}")

    @property
    def ids(self) -> tuple[int, ...]:
        """Numbers of its servos, the gripper's last."""
        return (*(joint.id for joint in self.joints), *((self.gripper.id,) if self.gripper else ()))

    @property
    def models(self) -> dict[int, int]:
        """Model numbers of its servos by id."""
        gripper = {self.gripper.id: self.gripper.model} if self.gripper else {}
        return {joint.id: joint.model for joint in self.joints} | gripper

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what `values` returns, in order."""
        return (
            *(f"{self.arm}_{joint.name}" for joint in self.joints),
            *((f"{self.arm}_gripper",) if self.gripper else ()),
        )

    def name_of(self, id_: int) -> str:
        """Return what a servo moves."""
        return next((joint.name for joint in self.joints if joint.id == id_), "gripper")

    def turns(self, servos: Floats) -> Floats:
        """Return what to add to the joints so that each is on the turn nearest to its reference, shape (n,) [rad]."""
        reference = np.array([joint.reference_rad for joint in self.joints])
        return np.asarray(np.rint((reference - self._joints(servos)) / _TURN) * _TURN)

    def values(self, servos: Floats, turns: Floats) -> Floats:
        """Return the joints [rad] and, last, the gripper from 0 (open) to 1, for what the servos show [rad]."""
        joints = self._joints(servos) + turns
        if self.gripper is None:
            return np.asarray(joints)
        travel = self.gripper.closed_rad - self.gripper.open_rad
        from_open = math.remainder(servos[-1] - self.gripper.open_rad, _TURN)  # the trigger makes no whole turns
        return np.append(joints, min(max(from_open / travel, 0.0), 1.0))

    def check(self, found: dict[int, int], port: str) -> None:
        """See that the servos on a bus are those that were calibrated.

        Args:
            found: Model numbers by id, of the servos that answer.
            port: The name of the bus, for the message.

        Raises:
            DeviceError: some are missing, or are of another model.
        """
        missing = [id_ for id_ in self.ids if id_ not in found]
        if missing:
            silent = ", ".join(f"{id_} ({self.name_of(id_)})" for id_ in missing)
            answering = ", ".join(map(str, sorted(found))) or "none"
            raise DeviceError(
                f"{port}: no answer from servo {silent}; {answering} of {len(self.ids)} answer: "
                "see to the cable before the first that is missing, and to the power"
            )
        for id_, model in self.models.items():
            if found[id_] != model:
                raise DeviceError(
                    f"{port}: servo {id_} ({self.name_of(id_)}) is a {model_name(found[id_])}, but the calibration of "
                    f"{self.serial} says {model_name(model)}; calibrate this leader: station devices calibrate gello"
                )

    def _joints(self, servos: Floats) -> Floats:
        offsets = np.array([joint.offset_rad for joint in self.joints])
        signs = np.array([joint.sign for joint in self.joints])
        return np.asarray((servos[: len(self.joints)] - offsets) * signs)


def nearest_offset(servo_rad: float, joint_rad: float, sign: int) -> float:
    """Return the offset, a multiple of a quarter turn, that brings a joint nearest to where it is known to be [rad]."""
    quarters = round((servo_rad - sign * joint_rad) / QUARTER)
    return max(-MOST_QUARTERS, min(MOST_QUARTERS, quarters)) * QUARTER


def default_folder() -> Path:
    """Return where calibrations are kept, ``$XDG_CONFIG_HOME/station/gello``; not necessarily there."""
    return calibration_file.default_folder("gello")


def file_of(folder: Path, serial: str) -> Path:
    """Return the file of the calibration of a leader."""
    return folder / f"{serial}.yaml"


def load(folder: Path, serial: str) -> Calibration:
    """Read the calibration of a leader.

    Raises:
        DeviceError: there is none.
        BadFile: it cannot be read, or is that of another leader.
    """
    path = file_of(folder, serial)
    missing = f"leader {serial} has no calibration ({path}); make one: station devices calibrate gello"
    found = calibration_file.read(path, Calibration, of="a leader", missing=missing)
    if found.serial != serial:
        raise BadFile(
            f"{path}: is the calibration of leader {found.serial}, expected that of {serial}; "
            "calibrate this one: station devices calibrate gello"
        )
    return found


def save(folder: Path, calibration: Calibration) -> Path:
    """Write a calibration; return its file.

    Raises:
        BadFile: it cannot be written.
    """
    return calibration_file.write(file_of(folder, calibration.serial), calibration)
