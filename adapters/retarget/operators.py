"""Operators whose bodies were measured: where that is kept, by name, and measuring them of a device's samples."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from adapters.retarget import calibration
from adapters.retarget.calibration import MEASURE, Calibration, Pose
from adapters.retarget.scaling import segments
from station.errors import BadFile, UsageError, did_you_mean
from station.operator.measure import MeasurementResult
from station.operator.sample import OperatorSample

_POSES: dict[str, Pose] = {"t": "t-pose", "standing": "standing"}
_UPRIGHT = "stand straight, feet flat below the hips and pointing forward, look ahead, arms "
_LONGEST_NAME = 100
_NOTE = (
    "scale: robot over operator. The robot's bones point where the operator's do, each at its own length; paths over "
    "the floor are scaled by the leg."
)


def folder() -> Path:
    """Return where operators' calibrations are kept, ``$XDG_CONFIG_HOME/station/operators``; perhaps not there."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base).absolute() if base else Path.home() / ".config") / "station" / "operators"


def file_of(operator: str) -> Path:
    """Return the file of an operator; perhaps not there.

    Raises:
        UsageError: that is no name of a file.
    """
    name = f"{operator}.yaml"
    is_plain = operator.isprintable() and not operator.startswith(".") and operator == operator.strip()
    if not operator or not is_plain or len(operator) > _LONGEST_NAME or Path(name).name != name:
        raise UsageError(f"operator: {operator!r} is no name; expected one as in ada, without folders")
    return folder() / name


def load(operator: str) -> tuple[Calibration, Path]:
    """Read the calibration of an operator; return it with its file.

    Raises:
        UsageError: there is none under this name; the message says what to do.
    """
    file = file_of(operator)
    if not file.is_file():
        near = sorted(path.stem for path in file.parent.glob("*.yaml")) if file.parent.is_dir() else []
        raise BadFile(
            f"{file}: no calibration of {operator!r}{did_you_mean(operator, near)}; {MEASURE}; or leave out `operator` "
            "to go by options.height_m"
        )
    return calibration.load(file), file


def facts(known: Calibration, file: Path | None) -> dict[str, Any]:
    """Return what a manifest says of the calibration that was used: whose, and of which bytes."""
    told: dict[str, Any] = {"operator": known.operator, "pose": known.pose, "height_m": known.height_m}
    if known.date:
        told |= {"date": known.date, "device": known.device}
    if file is not None:
        told |= {"file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
    return told


class BodyMeasure:
    """Implements `station.operator.measure.OperatorMeasure` by the 24 joints of a tracked body."""

    poses: Mapping[str, str] = {
        "t": _UPRIGHT + "straight out to both sides, palms down",
        "standing": _UPRIGHT + "hanging, palms to the thighs",
    }

    def why_not(self, sample: OperatorSample) -> str:
        """A body is needed, and when it was seen."""
        if sample.body is None:
            return "the body is not tracked; are the trackers on, and is body tracking started in the headset?"
        return "" if sample.capture_ns is not None else "the device does not say when it saw the body"

    def file(self, operator: str) -> Path:
        """See `file_of`."""
        return file_of(operator)

    def measure(
        self, readings: Sequence[OperatorSample], operator: str, pose: str, *, device: str, source: str
    ) -> MeasurementResult:
        """Measure an operator; raises `adapters.retarget.calibration.NotCalibrated`."""
        bodies = [sample.body for sample in readings if sample.body is not None]
        found = calibration.calibrate(bodies, operator, _pose(pose), device=device, source=source)
        rows = [
            (part.name, f"{part.operator_m:.3f} m", f"{part.robot_m:.3f} m", f"{part.scale:.2f}")
            for part in segments(found.lengths_m)
        ]
        about = f"{operator} is {found.height_m:.2f} m tall, measured in {len(bodies)} samples"
        return MeasurementResult(about, ("part", operator, "robot", "scale"), rows, _NOTE, found)

    def keep(self, measured: MeasurementResult) -> Path:
        """Write the calibration under the operator's name."""
        file = file_of(measured.kept.operator)
        calibration.save(measured.kept, file)
        return file

    def how_to_use(self, operator: str) -> str:
        """The driver `body` takes it by name."""
        return f"--set teleop.driver=body --set teleop.operator={operator}"


def _pose(name: str) -> Pose:
    if name not in _POSES:
        raise UsageError(f"pose: {name!r}; expected {' or '.join(_POSES)}")
    return _POSES[name]
