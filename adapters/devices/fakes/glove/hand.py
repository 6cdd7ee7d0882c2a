"""Scripted gloves: how far an operator closes the hand, and what goes wrong with the glove.

    {"device": "glove", "period_s": 4.0, "steps": [
        {"at_s": 0, "left": [0, 0, 0, 0, 0]},          how far each sensor is closed, 0 open to 1 closed
        {"at_s": 2, "left": [1, 1, 1, 1, 1]},          reached in a straight line
        {"at_s": 2.5, "silent": true}, {"at_s": 3, "silent": false},
        {"at_s": 3.2, "garbage": 5}, {"at_s": 3.4, "cut": 2},
        {"at_s": 3.6, "plugged": false}, {"at_s": 3.8, "plugged": true}]}

A script that names ``left`` and ``right`` has two gloves; ``side`` says whose a fault is, of both without it. The first
step may say ``protocol``, numbers without it, and ``sensors``, a name for each, by how many there are without it. The
fake gloves come calibrated, with numbers that rise on one sensor and fall on the next as the hand closes.
"""

from __future__ import annotations

import threading
from pathlib import Path

import msgspec
import numpy as np

from adapters.devices.fakes.glove.port import FakePort
from adapters.devices.fakes.script import Clock, Play, Script, Step
from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove.calibration import Calibration, SensorCalibration, Side
from adapters.devices.glove.lines import Protocol
from adapters.devices.glove.sensors import PRESETS, UNUSED, why_not
from station.errors import BadFile
from station.protocols import Floats

SIDES: tuple[Side, ...] = ("left", "right")
GARBAGE = b"\xff\x00boot: 12 nan\x1b[2J\n"


class GloveStep(Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What gloves may do.

    Attributes:
        left, right: How far each sensor is closed at this time, 0 open to 1 closed.
        protocol: How they write; said by the first step.
        sensors: What the sensors are called, in the order of the line; said by the first step.
        side: Whose faults the following are; None for both.
        silent: Whether nothing is written from now on.
        garbage: How many of the next lines are none.
        cut: How many of the next lines end in their middle, and the one after goes on there.
        plugged: Whether the port is there from now on.
    """

    left: list[float] | None = None
    right: list[float] | None = None
    protocol: Protocol | None = None
    sensors: list[str] | None = None
    side: Side | None = None
    silent: bool | None = None
    garbage: int | None = None
    cut: int | None = None
    plugged: bool | None = None


class FakeGlove:
    """One glove: a port, and the hand in it.

    Args:
        side: Which.
        script: What happens.
        clock: Tells the time [s].
        folder: Where the port appears, and its calibration in ``calibrations`` beneath.
        start_s: Time of the script to begin at, and to be held as at until then [s].
    """

    def __init__(self, side: Side, script: Script[GloveStep], clock: Clock, folder: Path, start_s: float = 0.0) -> None:
        self.side, self.serial = side, f"FAKE-{side.upper()}"
        self._play, self._start_s, self._period_s = Play(script, clock), start_s, script.period_s
        frames = [(step.at_s, values) for step in script.steps if (values := getattr(step, side)) is not None]
        self._times_s, self._held = np.array([at_s for at_s, _ in frames]), np.array([values for _, values in frames])
        self.calibration = _calibration(side, self.serial, script.steps[0], self._held.shape[1])
        calibrations.save(folder / "calibrations", self.calibration)
        self._lock = threading.Lock()
        self._is_silent, self._garbage, self._cut = False, 0, 0
        self.port = FakePort(folder, self.serial, self.next_bytes)

    def begin(self) -> None:
        """Start the script's clock; lines that were spoilt before its time are not spoilt again."""
        with self._lock:
            self._play.begin(self._start_s)
            if self._start_s > 0.0:
                for _, step in self._play.due(self._start_s):
                    self._do(msgspec.structs.replace(step, garbage=None, cut=None))

    def close(self) -> None:
        """Take the port away."""
        self.port.close()

    def next_bytes(self) -> bytes:
        """Return what the glove writes now."""
        with self._lock:
            now_s = self._start_s
            if self._play.has_begun:
                now_s = self._play.time_s()
                for _, step in self._play.due(now_s):
                    self._do(step)
            if self._is_silent:
                return b""
            line = self.line(now_s)
            if self._garbage > 0:
                self._garbage -= 1
                return GARBAGE
            if self._cut > 0:
                self._cut -= 1
                return line[: len(line) // 2]
            return line

    def line(self, now_s: float) -> bytes:
        """Return the line of the hand at a time of the script [s]."""
        closed = self.closed(now_s)
        shown = [0] * self.calibration.numbers
        for sensor, share in zip(self.calibration.sensors, closed, strict=True):
            shown[sensor.number] = round(sensor.open + share * (sensor.closed - sensor.open))
        if self.calibration.protocol == "opengloves":
            return "".join(f"{letter}{count}" for letter, count in zip("ABCDE", shown, strict=True)).encode() + b"\n"
        return " ".join(map(str, shown)).encode() + b"\r\n"

    def closed(self, now_s: float) -> Floats:
        """Return how far each sensor is closed at a time of the script [s], shape (n,)."""
        columns = [self._held[:, sensor.number] for sensor in self.calibration.sensors]
        return np.array([np.interp(now_s, self._times_s, column, period=self._period_s) for column in columns])

    def _do(self, step: GloveStep) -> None:
        if step.side not in (None, self.side):
            return
        if step.silent is not None:
            self._is_silent = step.silent
        self._garbage += step.garbage or 0
        self._cut += step.cut or 0
        if step.plugged is not None:
            (self.port.plug if step.plugged else self.port.unplug)()


def sides_of(script: Script[GloveStep], file: Path) -> list[Side]:
    """Return the hands that a script moves.

    Raises:
        BadFile: none, or one of changing numbers of sensors, of a number without names, or of wrong names.
    """
    first = script.steps[0]
    names = tuple(first.sensors or ())
    if names and (why := why_not([name for name in names if name != UNUSED])):
        raise BadFile(f"{file}: sensors: {why}")
    known = (len(names),) if names else tuple(PRESETS)
    if first.protocol == "opengloves":
        known = (len(PRESETS[5]),)
    sides: list[Side] = []
    for side in SIDES:
        sizes = {len(values) for step in script.steps if (values := getattr(step, side)) is not None}
        if sizes and (len(sizes) > 1 or not sizes <= set(known)):
            wanted = " or ".join(map(str, known))
            raise BadFile(f"{file}: {side}: {sorted(sizes)} values; expected {wanted}, the same every time")
        if sizes:
            sides.append(side)
    if not sides:
        raise BadFile(f"{file}: no step says how left or right is held")
    return sides


def _calibration(side: Side, serial: str, first: GloveStep, count: int) -> Calibration:
    names = first.sensors or PRESETS[count]
    sensors = []
    for number, name in enumerate(names):
        low, high = 700.0 + 20.0 * number, 3300.0 - 30.0 * number
        opened, closed = (high, low) if number % 2 else (low, high)
        sensors.append(SensorCalibration(name=name, number=number, open=opened, closed=closed))
    return Calibration(
        serial=serial, side=side, date="2026-01-01", protocol=first.protocol or "numbers", numbers=count,
        sensors=tuple(sensor for sensor in sensors if sensor.name != UNUSED),
    )  # fmt: skip
