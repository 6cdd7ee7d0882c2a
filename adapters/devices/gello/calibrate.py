"""Calibrating a leader arm, step by step, with the person who holds it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adapters.devices import calibration_file
from adapters.devices.console import Console
from adapters.devices.gello import calibration as calibrations
from adapters.devices.gello import ports
from adapters.devices.gello.bus import BUSES, MotorBus, Servos, model_name
from adapters.devices.gello.calibration import (
    LEAST_TRAVEL_RAD,
    Arm,
    Calibration,
    GripperCalibration,
    JointCalibration,
    nearest_offset,
)
from adapters.devices.serial_port import serial_of
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.protocols import Floats

SIGNS: dict[str, tuple[int, ...]] = {
    "ur": (1, 1, -1, 1, 1, 1),
    "panda": (1, 1, 1, 1, 1, -1, 1),
    "xarm7": (1, -1, 1, 1, 1, -1, 1),
    "yam": (1, -1, -1, -1, 1, 1),
}
"""How the servos of the published leaders turn, by follower."""

FAR_OFF_RAD = math.radians(20.0)
"""A joint further than this from where it is to be held makes the quarter turn doubtful."""

_MOVED_RAD = math.radians(8.0)
_STILL_RAD = math.radians(2.0)
_READINGS = 10
_ATTEMPTS = 50
_PAUSE_S = 0.01


@dataclass(frozen=True)
class Plan:
    """What is to be calibrated.

    Attributes:
        arm: Which arm of the follower it leads.
        joint_names: Of the follower, in order; the servos' ids count in the same order.
        pose_rad: Where the joints are to be held, shape (n,) [rad].
        signs: How the servos turn, 1 or -1 each; None to find out by turning each joint.
        has_gripper: Whether the last servo is a gripper's.
    """

    arm: Arm
    joint_names: tuple[str, ...]
    pose_rad: tuple[float, ...]
    signs: tuple[int, ...] | None = None
    has_gripper: bool = True

    def __post_init__(self) -> None:
        for what, values in (("pose", self.pose_rad), ("signs", self.signs)):
            if values is not None and len(values) != len(self.joint_names):
                raise DeviceError(f"{len(values)} numbers of the {what} for {len(self.joint_names)} joints")


def calibrate_port(
    port: str,
    plan: Plan,
    console: Console,
    *,
    servos: Servos = "dynamixel",
    baud: int | None = None,
    folder: Path | None = None,
    clock: Clock = SYSTEM,
) -> Path:
    """Calibrate the leader on a serial port and keep what was found; return the file.

    Args:
        port: Name of the port, such as `adapters.devices.gello.ports.choose` returns.
        plan: What is to be calibrated.
        console: The person at the leader.
        servos: Whose servos it has.
        baud: Rate of the servos [bit/s]; None for the most usual of theirs.
        folder: Where calibrations are kept; None for that of the user's settings.
        clock: Of the process.

    Raises:
        DeviceError: the port cannot be opened, the servos do not fit the plan, or one falls silent.
        BadFile: the calibration cannot be written.
    """
    kind = BUSES[servos]
    bus = kind(port, baud or kind.bauds[0], clock)
    try:
        if advice := ports.latency_advice(port):
            console.show(advice)
        return calibrate(bus, serial_of(port), plan, console, folder or calibrations.default_folder())
    finally:
        bus.close()


def calibrate(bus: MotorBus, serial: str, plan: Plan, console: Console, folder: Path) -> Path:
    """Calibrate the leader on a bus and keep what was found; return the file.

    Raises:
        DeviceError: the servos do not fit the plan, or one falls silent.
        BadFile: the calibration cannot be written.
    """
    models = _servos(bus, plan, console)
    ids = list(models)
    signs = plan.signs or _find_signs(bus, ids, plan, console)
    joints = _find_offsets(bus, ids, models, signs, plan, console)
    gripper = _find_gripper(bus, ids[-1], models[ids[-1]], console) if plan.has_gripper else None
    made = Calibration(serial=serial, arm=plan.arm, date=calibration_file.today(), joints=joints, gripper=gripper)
    file = calibrations.save(folder, made)
    console.show(f"leader {serial} is calibrated as the {plan.arm} arm: {file}")
    return file


def _servos(bus: MotorBus, plan: Plan, console: Console) -> dict[int, int]:
    """Return the model numbers of the servos by id, those of the joints first, then the gripper's."""
    models = bus.scan()
    wanted = len(plan.joint_names) + plan.has_gripper
    listed = ", ".join(f"{id_} ({model_name(model)})" for id_, model in models.items()) or "none"
    if len(models) != wanted:
        raise DeviceError(
            f"{bus.port}: {len(models)} servos answer at {bus.baud} baud ({listed}), expected {wanted}; "
            "see to cables, power, ids that are given twice, and baud:"
        )
    console.show(f"servos: {listed}")
    return models


def _find_signs(bus: MotorBus, ids: Sequence[int], plan: Plan, console: Console) -> tuple[int, ...]:
    """Ask for a turn of each joint."""
    signs = []
    for index, name in enumerate(plan.joint_names):
        while True:
            before = _measure(bus, ids, console)[index]
            console.ask(f"Turn {name} by about 30° in its positive direction and hold it there; then Enter")
            moved = math.remainder(_measure(bus, ids, console)[index] - before, math.tau)
            if abs(moved) > _MOVED_RAD:
                break
            console.show(f"{name}: servo {ids[index]} has moved by {math.degrees(moved):+.0f}° only; once more")
        signs.append(1 if moved > 0 else -1)
        console.show(f"{name}: servo {ids[index]} turns {'with' if moved > 0 else 'against'} the joint")
    return tuple(signs)


def _find_offsets(
    bus: MotorBus, ids: Sequence[int], models: dict[int, int], signs: Sequence[int], plan: Plan, console: Console
) -> tuple[JointCalibration, ...]:
    """Ask for a known pose, and take for each joint the quarter turn that comes nearest to it."""
    pose = ", ".join(f"{name} {math.degrees(q):.0f}°" for name, q in zip(plan.joint_names, plan.pose_rad, strict=True))
    while True:
        console.ask(f"Hold the leader still in this pose: {pose}; then Enter")
        servos = _measure(bus, ids, console)
        offsets = [nearest_offset(*each) for each in zip(servos, plan.pose_rad, signs, strict=False)]
        found = [(servo - offset) * sign for servo, offset, sign in zip(servos, offsets, signs, strict=False)]
        off = [q - wanted for q, wanted in zip(found, plan.pose_rad, strict=True)]
        for name, offset, each in zip(plan.joint_names, offsets, off, strict=True):
            console.show(f"{name}: offset {offset / calibrations.QUARTER:+.0f} quarter turns, "
                        f"{math.degrees(each):+.1f}° from the pose")  # fmt: skip
        far = [name for name, each in zip(plan.joint_names, off, strict=True) if abs(each) > FAR_OFF_RAD]
        if not far:
            break
        limit = f"{math.degrees(FAR_OFF_RAD):.0f}°"
        console.show(f"{', '.join(far)}: more than {limit} from the pose, so the quarter turn is doubtful; once more")
    return tuple(
        JointCalibration(id=id_, name=name, model=models[id_], offset_rad=offset, sign=sign, reference_rad=q)
        for id_, name, offset, sign, q in zip(
            ids, plan.joint_names, offsets, signs, plan.pose_rad, strict=False
        )
    )  # fmt: skip


def _find_gripper(bus: MotorBus, id_: int, model: int, console: Console) -> GripperCalibration:
    while True:
        console.ask("Let the gripper's trigger go, fully open; then Enter")
        opened = float(_measure(bus, [id_], console)[0])
        console.ask("Pull the trigger, fully closed, and hold it; then Enter")
        closed = opened + math.remainder(float(_measure(bus, [id_], console)[0]) - opened, math.tau)
        if abs(closed - opened) >= LEAST_TRAVEL_RAD:
            break
        console.show(f"the trigger has moved by {math.degrees(closed - opened):+.0f}° only; once more")
    console.show(f"gripper: {math.degrees(closed - opened):+.0f}° from open to closed")
    return GripperCalibration(id=id_, model=model, open_rad=opened, closed_rad=closed)


def _measure(bus: MotorBus, ids: Sequence[int], console: Console) -> Floats:
    """Return where the servos stand, the mean of some readings while they are held still [rad]."""
    while True:
        readings = np.array([_positions(bus, ids) for _ in range(_READINGS)])
        if np.ptp(readings, axis=0).max() < _STILL_RAD:
            return np.asarray(readings.mean(axis=0))
        console.ask("It moved; hold it still, then Enter")


def _positions(bus: MotorBus, ids: Sequence[int]) -> Floats:
    for _ in range(_ATTEMPTS):
        positions = bus.positions(ids)
        if positions is not None:
            bus.clock.sleep(_PAUSE_S)
            return positions
    silent = [str(id_) for id_ in ids if id_ not in bus.ping(ids)]
    raise DeviceError(f"{bus.port}: servo {', '.join(silent) or 'answers torn'} is silent; see to its cable")
