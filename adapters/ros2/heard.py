"""Messages of ROS 2 as numbers of a command, or one line that says why not."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from adapters.ros2.cdr import Cursor
from adapters.ros2.table import SubscribeRow
from station.errors import ConfigError
from station.protocols import CommandFormat

_MOST_JOINTS = 1000
_POSITION = "_pos"
_PLANAR = ("vx", "vy", "wz")


class BadMessage(ValueError):
    """A message that is no command.

    Attributes:
        kind: Why, in a word that is counted.
    """

    def __init__(self, text: str, kind: str = "not-a-message") -> None:
        super().__init__(text)
        self.kind = kind


class Heard(NamedTuple):
    """What a message says.

    Attributes:
        numbers: In the order of the command.
        stamp_ns: Of its header [ns since the epoch]; 0 where it has none.
    """

    numbers: list[float]
    stamp_ns: int


Read = Callable[[bytes], Heard]
"""Reads a message; raises `BadMessage`."""


def reader(row: SubscribeRow, command: CommandFormat) -> Read:
    """Return what reads the messages of a topic.

    Raises:
        ConfigError: such messages do not hold such a command.
    """
    names = tuple(element.name for element in command.elements)
    if row.kind == "joint-state":
        return _joints(row, names)
    if row.kind == "float32-array":
        return lambda data: _array(data, len(names))
    if names != _PLANAR:
        raise ConfigError(
            f"{row.topic}: a {row.kind} holds {', '.join(_PLANAR)}; command {row.command!r} has {', '.join(names)}"
        )
    return _stamped_twist if row.kind == "twist-stamped" else _twist


def _twist(data: bytes) -> Heard:
    return Heard(_planar(Cursor(data, BadMessage)), 0)


def _stamped_twist(data: bytes) -> Heard:
    at = Cursor(data, BadMessage)
    stamp_ns, _ = at.header()
    return Heard(_planar(at), stamp_ns)


def _planar(at: Cursor) -> list[float]:
    vx, vy, vz, wx, wy, wz = at.numbers("d", 6)
    if not all(map(math.isfinite, (vx, vy, vz, wx, wy, wz))):
        raise BadMessage("a velocity that is not finite", "not-finite")
    if vz or wx or wy:
        raise BadMessage(
            f"linear.z {vz:g}, angular.x {wx:g}, angular.y {wy:g}; a robot on the ground takes none but 0", "not-planar"
        )
    return [vx, vy, wz]


def _array(data: bytes, length: int) -> Heard:
    at = Cursor(data, BadMessage)
    for _ in range(_counted(at, "dimensions")):
        at.text()
        at.numbers("I", 2)
    at.number("I")
    numbers = [float(number) for number in at.sequence("f")]
    if len(numbers) != length:
        raise BadMessage(f"{len(numbers)} numbers, expected {length}", "wrong-length")
    return Heard(numbers, 0)


def _joints(row: SubscribeRow, elements: tuple[str, ...]) -> Read:
    joints = row.joints
    ours = tuple(name.removesuffix(_POSITION) for name in elements)
    if not all(name.endswith(_POSITION) for name in elements):
        raise ConfigError(f"{row.topic}: command {row.command!r} holds no positions of joints, as a joint-state does")
    if joints is not None and {*joints.names} != {*ours}:
        odd = sorted({*joints.names} ^ {*ours})
        raise ConfigError(f"{row.topic}: joints.names and command {row.command!r} differ in {', '.join(odd)}")
    named, offset = (
        (ours, dict.fromkeys(ours, 0.0))
        if joints is None
        else (joints.names, dict(zip(joints.names, joints.offsets, strict=True)))
    )
    called = dict(zip(named, named if joints is None else joints.ros_names, strict=True))
    scale = 1.0 if joints is None else joints.scale
    wanted = [(called[name], offset[name]) for name in ours]
    expected = {*called.values()}

    def read(data: bytes) -> Heard:
        at = Cursor(data, BadMessage)
        stamp_ns, _ = at.header()
        names = [at.text() for _ in range(_counted(at, "joints"))]
        found = at.sequence("d")
        if len(names) != len(found):
            raise BadMessage(f"{len(names)} names and {len(found)} positions", "wrong-length")
        place = dict(zip(names, found, strict=True))
        if len(names) != len(place) or place.keys() != expected:
            odd = sorted({*names} ^ expected) or ["a joint that comes twice"]
            raise BadMessage(f"joints differ from the table's in {', '.join(odd[:3])}"[:200], "wrong-names")
        return Heard([at_rest + scale * place[name] for name, at_rest in wanted], stamp_ns)

    return read


def _counted(at: Cursor, what: str) -> int:
    """Return how many there are; more than any robot has are none."""
    if (count := at.number("I")) > _MOST_JOINTS:
        raise BadMessage(f"{count} {what}")
    return count
