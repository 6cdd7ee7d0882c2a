"""A real G1 as a robot that can be named; imports nothing heavy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from adapters.robots.g1 import description, wire
from adapters.robots.g1.dds import rows
from adapters.robots.g1.dds.options import G1DdsOptions
from station.bus import keys
from station.contract import Contract
from station.description import ROBOT, RobotDescription
from station.protocols import Robot
from station.robot_kind import RobotKind

if TYPE_CHECKING:  # it loads NumPy
    from station.protocols import CommandFormat

NAME = "g1-dds"

_SAMPLES = Contract(
    key=keys.state(f"samples_{ROBOT}"), family="station", role="state", codec="f64-rows", elements=rows.SAMPLES,
    rate_hz=50.0, note="every state that the robot sent since the last write, 500 a second: a row each, oldest first; "
    "tick is the robot's own clock; the IMU is the pelvis'",
)  # fmt: skip
_BATTERY = Contract(
    key=keys.state(f"battery_{ROBOT}"), family="station", role="state", codec="f64", elements=rows.BATTERY,
    rate_hz=None, note="as the robot's battery says",
)  # fmt: skip

_GUARD = Contract(
    key=keys.state(f"guard_{ROBOT}"), family="station", role="state", codec="json", rate_hz=10.0,
    note="what the guard of the motors says: its state and why, what it sent, took and refused",
)  # fmt: skip


def _make(options: G1DdsOptions, control_dt_s: float) -> Robot:
    from adapters.robots.g1.dds.robot import G1Dds

    return G1Dds(options, control_dt_s)


def _describe(command_format: CommandFormat) -> RobotDescription:
    found = description.of_server(command_format)
    return msgspec.structs.replace(found, streams=(*found.streams, _SAMPLES, _BATTERY, _GUARD))


DDS = RobotKind(
    name=NAME,
    about="Unitree G1 with 29 joints, the real one or its twin, over its own network",
    is_simulated=False,
    options=G1DdsOptions,
    make=_make,
    describe=_describe,
    values=wire.body_values,
    policy="tracker",
    robot_name="g1_29",
    library="cyclonedds",
    extra="g1",
)
