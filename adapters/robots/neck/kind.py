"""A neck as a robot that can be named; imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from adapters.robots.g1 import twist_keys
from adapters.robots.neck.options import NeckOptions
from station.bus import codec
from station.bus.robot_streams import command_streams, driven_by_policy
from station.contract import names_of
from station.description import Joint, RobotDescription
from station.robot_kind import RobotKind

if TYPE_CHECKING:  # they load NumPy
    from station.protocols import CommandFormat, Policy, Robot, RobotState


def _make(options: NeckOptions, control_dt_s: float) -> Robot:
    from adapters.robots.neck.neck import DynamixelNeck

    return DynamixelNeck(options, control_dt_s)


def _describe(command_format: CommandFormat) -> RobotDescription:
    names = [name.removesuffix("_pos") for name in names_of(command_format.elements)]
    ends = zip(names, command_format.lower.tolist(), command_format.upper.tolist(), strict=True)
    return RobotDescription(
        name=command_format.robot,
        model="dynamixel_neck",
        joints=tuple(Joint(name, lower, upper) for name, lower, upper in ends),
        is_carried=True,
        streams=(*command_streams(command_format), *driven_by_policy(command_format.elements)),
    )


def _values(state: RobotState, policy: Policy, robot: str) -> Mapping[str, bytes]:
    """What TWIST2's programs read of a neck."""
    return {twist_keys.state_neck(): codec.json_vector(state.q)}


NECK = RobotKind(
    name="neck-dynamixel",
    about="a neck of two Dynamixel servos on a serial port, as TWIST2's robot has",
    is_simulated=False,
    options=NeckOptions,
    make=_make,
    describe=_describe,
    values=_values,
    policy="direct",
    checkpoint="builtin:neck.hand.yaml",
    library="dynamixel-sdk",
    extra="gello",
)
