"""The drivers as they are registered: by name, with options; the IK is imported when one is made."""

from __future__ import annotations

from pathlib import Path

import msgspec

from adapters.drivers.arm_options import ArmOptions
from adapters.drivers.glove import GloveDriver, GloveOptions
from adapters.drivers.hands import HandsDriver, HandsOptions
from adapters.drivers.jog import JogDriver
from adapters.drivers.joints import JointsDriver, JointsOptions
from adapters.drivers.neck import SCALE
from adapters.drivers.velocity import VelocityDriver, VelocityOptions
from adapters.drivers.walk import WalkDriver
from station.operator.driver import Driver, DriverKind


class NoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to choose."""


class BodyOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the driver `body`.

    Attributes:
        height_m: How tall an operator is who has not been measured [m].
        calibration: File with the operator's measurements; None for the one that is kept under the operator's name.
        neck_scale: How far the neck turns for each radian of the head; 0 keeps it still.
        robot: Part of a robot that takes motions, such as ``g1_29_track``; "" for the robot that TWIST2 knows.
    """

    height_m: float = 1.75
    calibration: Path | None = None
    neck_scale: float = SCALE
    robot: str = ""

    def __post_init__(self) -> None:
        if not 1.0 <= self.height_m <= 2.3:
            raise ValueError(f"height_m is {self.height_m:g}; expected 1 to 2.3 m")
        if not 0.0 <= self.neck_scale <= 3.0:
            raise ValueError(f"neck_scale is {self.neck_scale:g}; expected 0 to 3 (stock TWIST2: {SCALE:g})")


def _body(options: BodyOptions, operator: str) -> Driver:
    from adapters.drivers.body import BodyDriver
    from adapters.retarget import calibration, operators
    from adapters.retarget.pipeline import BodyRetarget

    file = options.calibration
    if file is not None:
        known = calibration.load(file)
    elif operator:
        known, file = operators.load(operator)
    else:
        known = calibration.from_height(options.height_m)
    return BodyDriver(
        BodyRetarget(known),
        calibration=operators.facts(known, file),
        neck_scale=options.neck_scale,
        robot=options.robot,
    )


def _arm_joints(options: ArmOptions, operator: str) -> Driver:
    from adapters.drivers.arm import ArmDriver

    return ArmDriver("arm-joints", options, "joints")


def _arm_tcp(options: ArmOptions, operator: str) -> Driver:
    from adapters.drivers.arm import ArmDriver

    return ArmDriver("arm-tcp", options, "tool")


_ARM_RATE_HZ = 250.0  # a target for each tick of a Kassow's controller
_ARM_MOVES = {
    "keyboard": "joints: 1 to 7, left, right choose one, up, down turn it; "
    "tool: w s a d, page up, page down move, i k pitch, j l turn, comma, period roll",
    "gamepad": "joints: right stick sideways chooses one, left stick turns it; tool: left stick, right stick, d-pad",
}

ARM_JOINTS = DriverKind(
    name="arm-joints",
    summary="a twist, sticks or keys turn the joints of an arm, or a leader arm leads them",
    options=ArmOptions,
    make=_arm_joints,
    rate_hz=_ARM_RATE_HZ,
    moves=_ARM_MOVES,
)
ARM_TCP = DriverKind(
    name="arm-tcp",
    summary="a twist, a hand, sticks or keys move the tool of an arm",
    options=ArmOptions,
    make=_arm_tcp,
    rate_hz=_ARM_RATE_HZ,
    moves=_ARM_MOVES,
)
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
    moves={
        "keyboard": "w s forwards and back, a d turn, j l sideways, i k height",
        "gamepad": "left stick forwards and sideways, right stick turn and height",
    },
)
GLOVE = DriverKind(
    name="glove",
    summary="the fingers of a robot's hand bend as those in a glove do, or as those that a headset sees",
    options=GloveOptions,
    make=lambda options, operator: GloveDriver(options),
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
VELOCITY = DriverKind(
    name="velocity",
    summary="sticks, keys or a twist say how fast a robot on legs goes, turns, and how high it stands",
    options=VelocityOptions,
    make=lambda options, operator: VelocityDriver(options),
    moves={
        "keyboard": "w s forwards and back, a d turn, j l sideways",
        "gamepad": "left stick forwards and sideways, right stick turns",
        "pico": "left stick forwards and sideways, right stick turns",
        "spacemouse": "pushed forwards, back and sideways, twisted to turn",
    },
)
