"""What a key holds: its role, its codec, and the name and unit of every element, in order."""

from __future__ import annotations

from typing import Literal, get_args

import msgspec

Role = Literal["command", "state", "policy", "sensor", "network", "event", "control"]
VectorCodec = Literal["json-vector", "f32", "f64"]
Codec = Literal[VectorCodec, "f64-rows", "json", "jpeg", "png", "point-cloud", "text", "integer"]


class Element(msgspec.Struct, frozen=True):
    """One number of a vector: a name that is a valid field name anywhere, and its unit ("" for none)."""

    name: str
    unit: str

    @property
    def title(self) -> str:
        """What a person reads of it: ``left_knee_pos [rad]``, or its name alone where it has no unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def elements(*groups: tuple[tuple[str, ...], str]) -> tuple[Element, ...]:
    """Build elements from groups of names that share a unit."""
    return tuple(Element(name, unit) for names, unit in groups for name in names)


def names_of(items: tuple[Element, ...]) -> tuple[str, ...]:
    """Return the names of elements, in order."""
    return tuple(item.name for item in items)


def positions(names: tuple[str, ...]) -> tuple[str, ...]:
    """Element names of joint positions."""
    return tuple(f"{name}_pos" for name in names)


class Contract(msgspec.Struct, frozen=True, kw_only=True):
    """What a key holds.

    Attributes:
        key: The key.
        family: Whose key it is: ``station``, or the name of the command format or the programs that speak it.
        role: What the value is to a station.
        codec: How the bytes are read; ``f64-rows`` is any number of vectors one after the other, each of all elements.
        elements: Names and units of a vector's numbers in order; empty for other values.
        rate_hz: Nominal rate of writes [Hz]; None when it is written on events only.
        step_m: What a step of a depth picture is [m]; None for what is none.
        note: Frame, order and traps, in a sentence.
    """

    key: str
    family: str
    role: Role
    codec: Codec
    elements: tuple[Element, ...] = ()
    rate_hz: float | None = None
    step_m: float | None = None
    note: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the elements, in order."""
        return names_of(self.elements)

    @property
    def vector_codec(self) -> VectorCodec | None:
        """How its bytes are read as numbers in order; None where they are none."""
        return next((codec for codec in get_args(VectorCodec) if codec == self.codec), None)


POSE = elements((("x", "y", "z"), "m"), (("qw", "qx", "qy", "qz"), ""))

WORLD_FRAME, OPERATOR_FRAME = "world", "operator"
"""Frames that things are in: where the root of a robot is told, and where an operator's devices tell their poses."""

DEPTH_STEP_M = 0.001
"""What a step is in the depth pictures that the station's cameras write [m]."""

IMU = elements((("gyro_x", "gyro_y", "gyro_z"), "rad/s"), (("acc_x", "acc_y", "acc_z"), "m/s^2"))

TIMING_STAGES = ("command_written", "command_arrived", "state_read", "observed", "inferred", "sent")
"""Instants of one policy step, in the order of `keys.policy_timing`."""
