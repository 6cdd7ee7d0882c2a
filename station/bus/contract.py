"""What a contract of a key is, and what contracts are made of; `station.bus.contracts` holds those of every key."""

from __future__ import annotations

from typing import Literal, get_args

import msgspec

from station.elements import Element, elements, names_of

Role = Literal["command", "state", "policy", "sensor", "network", "event", "control"]
VectorCodec = Literal["json-vector", "f32", "f64"]
Codec = Literal[VectorCodec, "json", "jpeg", "text", "integer"]


class Contract(msgspec.Struct, frozen=True, kw_only=True):
    """What a key holds.

    Attributes:
        key: The key.
        family: Whose key it is: ``station``, or the name of the command format or the programs that speak it.
        role: What the value is to a station.
        codec: How the bytes are read.
        elements: Names and units of a vector's numbers in order; empty for other values.
        rate_hz: Nominal rate of writes [Hz]; None when it is written on events only.
        note: Frame, order and traps, in a sentence.
    """

    key: str
    family: str
    role: Role
    codec: Codec
    elements: tuple[Element, ...] = ()
    rate_hz: float | None = None
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

TIMING_STAGES = ("command_written", "command_arrived", "state_read", "observed", "inferred", "sent")
"""Instants of one policy step, in the order of `keys.policy_timing`."""
