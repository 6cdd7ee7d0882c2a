"""The drivers as they are registered: by name, with options; the IK is imported when one is made."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from adapters.drivers.hands import HandsDriver, HandsOptions
from adapters.drivers.jog import JogDriver
from adapters.drivers.joints import JointsDriver, JointsOptions
from adapters.drivers.walk import WalkDriver
from station.errors import BadFile, did_you_mean
from station.operator.driver import Driver, DriverKind


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to choose."""


class BodyOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the driver `body`.

    Attributes:
        height_m: How tall an operator is who has not been measured [m].
        calibration: File with the operator's measurements; None for the one that is kept under the operator's name.
    """

    height_m: float = 1.75
    calibration: Path | None = None

    def __post_init__(self) -> None:
        if not 1.0 <= self.height_m <= 2.3:
            raise ValueError(f"height_m is {self.height_m:g}; expected 1 to 2.3 m")


def calibrations() -> Path:
    """Return where operators' calibrations are kept, ``$XDG_CONFIG_HOME/station/operators``; perhaps not there."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base).absolute() if base else Path.home() / ".config") / "station" / "operators"


def _body(options: BodyOptions, operator: str) -> Driver:
    from adapters.drivers.body import BodyDriver
    from adapters.retarget import calibration
    from adapters.retarget.pipeline import BodyRetarget

    file = options.calibration or (_file_of(operator) if operator else None)
    known = calibration.load(file) if file else calibration.from_height(options.height_m)
    return BodyDriver(BodyRetarget(known))


def _file_of(operator: str) -> Path:
    folder = calibrations()
    file = folder / f"{operator}.yaml"
    if file.name != f"{operator}.yaml":
        raise BadFile(f"operator: {operator!r} is no name; expected the name that was measured, without folders")
    if not file.is_file():
        known = sorted(path.stem for path in folder.glob("*.yaml")) if folder.is_dir() else []
        raise BadFile(
            f"{file}: no calibration of {operator!r}{did_you_mean(operator, known)}; measure the operator first, or "
            "leave out `operator` to go by options.height_m"
        )
    return file


BODY = DriverKind(
    name="body", summary="the robot does what the operator's whole body does", options=BodyOptions, make=_body
)
HANDS = DriverKind(
    name="hands",
    summary="palms follow the operator's hands, sticks walk",
    options=HandsOptions,
    make=lambda options, operator: HandsDriver(options),
)
WALK = DriverKind(
    name="walk",
    summary="sticks or keys walk, turn, squat",
    options=NoOptions,
    make=lambda options, operator: WalkDriver(),
)
JOG = DriverKind(
    name="jog",
    summary="a twist moves one palm, the other, or the legs",
    options=NoOptions,
    make=lambda options, operator: JogDriver(),
)
JOINTS = DriverKind(
    name="joints",
    summary="joints follow those of a leader arm",
    options=JointsOptions,
    make=lambda options, operator: JointsDriver(options),
)
