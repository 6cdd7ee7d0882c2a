"""The command of a robot's hand: absolute positions of its joints, each of which one finger of a person bends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from station.arms import JointCommand
from station.protocols import Floats

Side = Literal["left", "right"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HandCommand(JointCommand):
    """Implements `station.protocols.CommandFormat`; a hand without a command stays as it is.

    Attributes:
        side: Which hand of a person it follows.
        fingers: What of a person's hand bends each joint, of `adapters.devices.glove.sensors`: ``index_0`` for the
            knuckle of an index finger, ``index`` for all of it.
        opened, closed: Joints of an open and of a closed hand, shape (n,) [rad]; read-only.
    """

    side: Side
    fingers: tuple[str, ...]
    opened: Floats
    closed: Floats
