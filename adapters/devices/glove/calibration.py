"""What turns the numbers of a glove's line into how far each sensor is closed, kept by serial number and side.

    closed = (number - open) / (closed - open), 0 for the flat hand to 1 for the fist

A number may fall where another rises: which way a magnet or a potentiometer is mounted is no matter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from adapters.devices import calibration_file
from adapters.devices.glove.lines import Protocol
from adapters.devices.glove.sensors import why_not
from station.errors import BadFile
from station.protocols import Floats

Side = Literal["left", "right"]

MOST_NUMBERS = 64
"""Of a line."""


class SensorCalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One sensor.

    Attributes:
        name: What it is called (`adapters.devices.glove.sensors`).
        number: Which number of the line it is, from 0.
        open, closed: What it shows for the flat hand and for the fist [counts of the glove].
    """

    name: str
    number: int
    open: float
    closed: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.open) and math.isfinite(self.closed)) or self.open == self.closed:
            raise ValueError(
                f"sensor {self.name} shows {self.open:g} open and {self.closed:g} closed; expected two numbers"
            )


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Of one glove.

    Attributes:
        serial: Serial number of its USB adapter.
        side: The hand that wears it.
        date: Day of the calibration, ``2026-11-21``.
        protocol: How it writes.
        numbers: How many numbers its line has.
        sensors: In the order of `values`.
    """

    serial: str
    side: Side
    date: str
    protocol: Protocol
    numbers: int
    sensors: tuple[SensorCalibration, ...]

    def __post_init__(self) -> None:
        if not 1 <= self.numbers <= MOST_NUMBERS:
            raise ValueError(f"numbers is {self.numbers}; expected 1 to {MOST_NUMBERS}")
        if why := why_not(self.names):
            raise ValueError(why)
        used = [sensor.number for sensor in self.sensors]
        if not set(used) <= set(range(self.numbers)) or len(set(used)) < len(used):
            listed = ", ".join(map(str, used))
            raise ValueError(f"sensors are the numbers {listed} of the line; expected each of 0 to {self.numbers - 1} "
                             "at most once")  # fmt: skip

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what `values` returns, in order."""
        return tuple(sensor.name for sensor in self.sensors)

    def values(self, line: Sequence[float]) -> Floats:
        """Return how far each sensor is closed, 0 open to 1 closed, shape (n,), for the numbers of a line."""
        shown = np.array([line[sensor.number] for sensor in self.sensors])
        opened = np.array([sensor.open for sensor in self.sensors])
        closed = np.array([sensor.closed for sensor in self.sensors])
        return np.asarray(np.clip((shown - opened) / (closed - opened), 0.0, 1.0) + 0.0)  # no -0


def default_folder() -> Path:
    """Return where calibrations are kept, ``$XDG_CONFIG_HOME/station/glove``; not necessarily there."""
    return calibration_file.default_folder("glove")


def file_of(folder: Path, serial: str, side: Side) -> Path:
    """Return the file of the calibration of a glove."""
    return folder / f"{serial}-{side}.yaml"


def load(folder: Path, serial: str, side: Side) -> Calibration:
    """Read the calibration of a glove.

    Raises:
        DeviceError: there is none.
        BadFile: it cannot be read, or is that of another glove.
    """
    path = file_of(folder, serial, side)
    how = f"station devices calibrate glove --side {side}"
    missing = f"glove {serial} has no calibration for the {side} hand ({path}); make one: {how}"
    found = calibration_file.read(path, Calibration, of="a glove", missing=missing)
    if (found.serial, found.side) != (serial, side):
        raise BadFile(
            f"{path}: is the calibration of the {found.side} glove {found.serial}, expected that of the {side} glove "
            f"{serial}; calibrate this one: {how}"
        )
    return found


def save(folder: Path, calibration: Calibration) -> Path:
    """Write a calibration; return its file.

    Raises:
        BadFile: it cannot be written.
    """
    return calibration_file.write(file_of(folder, calibration.serial, calibration.side), calibration)
