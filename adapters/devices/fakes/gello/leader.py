"""Scripted leader arms: where an operator holds their joints, and what goes wrong with them.

    {"device": "gello", "steps": [
        {"at_s": 0, "left": [0, 0, 0, 0, 0, 0, 0, 0]},       seven joints [rad] and the gripper, 0 open to 1 closed
        {"at_s": 2, "left": [0.5, 0, 0, 0, 0, 0, 0, 1]},     reached in a straight line
        {"at_s": 3, "silent": [4]}, {"at_s": 4, "silent": []},
        {"at_s": 5, "plugged": false}, {"at_s": 6, "plugged": true}, {"at_s": 7, "broken": 2}]}

A script that names ``left`` and ``right`` has two leaders; ``arm`` says whose servos a fault is, of both without it.
The servos are Dynamixel's; ``"servos": "feetech"`` in a step makes them Feetech's, as in ``so101.json``. The fake
leaders come calibrated, with offsets and signs as a real one might have.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.servos import SERVOS, Chain, wrapped
from adapters.devices.fakes.script import Clock, Play, Script, Step
from adapters.devices.gello import calibration as calibrations
from adapters.devices.gello.bus import RAD_PER_TICK, Servos
from adapters.devices.gello.calibration import Arm, Calibration, GripperCalibration, JointCalibration
from station.errors import BadFile
from station.protocols import Floats

OPEN_RAD, CLOSED_RAD = math.radians(200.0), math.radians(158.0)
ARMS: tuple[Arm, ...] = ("left", "right")

_MOST_JOINTS = 16


class LeaderStep(Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What leaders may do.

    Attributes:
        left, right: Joints [rad] and, last, the gripper (0..1), at this time.
        servos: Whose servos the leaders have, from the beginning to the end.
        arm: Whose faults the following are; None for both.
        silent: The servos that answer nothing from now on.
        broken: How many of the next answers of each servo are torn.
        plugged: Whether the port is there from now on.
        power_cycled: Whether the servos lose their power for a moment, and with it the count of their turns.
    """

    left: list[float] | None = None
    right: list[float] | None = None
    servos: Servos | None = None
    arm: Arm | None = None
    silent: list[int] | None = None
    broken: int | None = None
    plugged: bool | None = None
    power_cycled: bool | None = None


class FakeLeader:
    """One leader: a port, its servos, and where their joints are.

    Args:
        arm: Which.
        script: What happens.
        clock: Tells the time [s].
        folder: Where the port appears, and its calibration in ``calibrations`` beneath.
        start_s: Time of the script to begin at, and to be held as at until then [s].
        servos: Whose servos it has.
    """

    def __init__(
        self,
        arm: Arm,
        script: Script[LeaderStep],
        clock: Clock,
        folder: Path,
        start_s: float = 0.0,
        servos: Servos = "dynamixel",
    ) -> None:
        self.arm, self.serial = arm, f"FAKE-{arm.upper()}"
        self._play, self._start_s = Play(script, clock), start_s
        self._period_s = script.period_s
        self._times_s, self._held = _keyframes(arm, script)
        self._turns_lost = np.zeros(self._held.shape[1])
        servo = SERVOS[servos]
        self.calibration = _calibration(self.arm, self.serial, self._held.shape[1] - 1, servo.usual_model)
        calibrations.save(folder / "calibrations", self.calibration)
        self._lock = threading.Lock()
        self._ticks = [0] * self._held.shape[1]
        self._show = wrapped if servos == "feetech" else int
        self.servos = [servo(index + 1, self._position_of(index)) for index in range(len(self._ticks))]
        self._update(start_s)
        self.port = FakePort(folder, self.serial, Chain(self.servos), before_reply=self._before_reply)

    def begin(self) -> None:
        """Start the script's clock; answers that were torn before its time are not torn again."""
        with self._lock:
            self._play.begin(self._start_s)
            if self._start_s > 0.0:
                for at_s, step in self._play.due(self._start_s):
                    self._do(at_s, msgspec.structs.replace(step, broken=None))

    def close(self) -> None:
        """Take the port away."""
        self.port.close()

    def _position_of(self, index: int) -> Callable[[], int]:
        return lambda: self._show(self._ticks[index])

    def _before_reply(self) -> None:
        with self._lock:
            if self._play.has_begun:
                now_s = self._play.time_s()
                for at_s, step in self._play.due(now_s):
                    self._do(at_s, step)
                self._update(now_s)

    def _do(self, at_s: float, step: LeaderStep) -> None:
        if step.arm not in (None, self.arm):
            return
        for servo in self.servos:
            servo.is_silent = servo.id in step.silent if step.silent is not None else servo.is_silent
            servo.broken_answers += step.broken or 0
        if step.power_cycled:
            shown = self._shown(at_s)
            self._turns_lost = np.floor(shown / math.tau) * math.tau
        if step.plugged is not None:
            (self.port.plug if step.plugged else self.port.unplug)()

    def _update(self, now_s: float) -> None:
        self._ticks[:] = np.rint((self._shown(now_s) - self._turns_lost) / RAD_PER_TICK).astype(int).tolist()

    def _shown(self, now_s: float) -> Floats:
        """Return what the servos show at a time [s], had they never lost a turn [rad]."""
        held = np.array([np.interp(now_s, self._times_s, column, period=self._period_s) for column in self._held.T])
        joints = [joint.offset_rad + joint.sign * q for joint, q in zip(self.calibration.joints, held, strict=False)]
        return np.array([*joints, OPEN_RAD + (CLOSED_RAD - OPEN_RAD) * held[-1]])


def arms_of(script: Script[LeaderStep], file: Path) -> list[Arm]:
    """Return the arms that a script moves.

    Raises:
        BadFile: none, or an arm of no joints, of too many, or of changing numbers.
    """
    arms: list[Arm] = []
    for arm in ARMS:
        sizes = {len(values) for step in script.steps if (values := getattr(step, arm)) is not None}
        if len(sizes) > 1 or any(not 2 <= size <= _MOST_JOINTS for size in sizes):
            raise BadFile(f"{file}: {arm}: {sorted(sizes)} values; expected the same joints and a gripper every time")
        if sizes:
            arms.append(arm)
    if not arms:
        raise BadFile(f"{file}: no step says where left or right is held")
    return arms


def servos_of(script: Script[LeaderStep], file: Path) -> Servos:
    """Return whose servos the leaders of a script have.

    Raises:
        BadFile: it says more than one.
    """
    named: list[Servos] = sorted({step.servos for step in script.steps if step.servos is not None})
    if len(named) > 1:
        raise BadFile(f"{file}: servos are {' and '.join(named)}; expected the same from the beginning to the end")
    return named[0] if named else "dynamixel"


def _keyframes(arm: Arm, script: Script[LeaderStep]) -> tuple[Floats, Floats]:
    frames = [(step.at_s, values) for step in script.steps if (values := getattr(step, arm)) is not None]
    return np.array([at_s for at_s, _ in frames]), np.array([values for _, values in frames], dtype=np.float64)


def _calibration(arm: Arm, serial: str, joints: int, model: int) -> Calibration:
    return Calibration(
        serial=serial,
        arm=arm,
        date="2026-01-01",
        joints=tuple(
            JointCalibration(
                id=index + 1, name=f"joint_{index + 1}", model=model, sign=1 if index % 3 else -1,
                offset_rad=(index % 4 + 1) * calibrations.QUARTER,
            )
            for index in range(joints)
        ),
        gripper=GripperCalibration(id=joints + 1, model=model, open_rad=OPEN_RAD, closed_rad=CLOSED_RAD),
    )  # fmt: skip
