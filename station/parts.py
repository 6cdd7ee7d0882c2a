"""The command of a robot whose parts are commanded apart: legs by one device, arms by another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from station.errors import ConfigError
from station.protocols import CommandFormat, StockKeys

if TYPE_CHECKING:
    from station.contract import Element
    from station.protocols import Floats, Reference


def parts_of(command_format: CommandFormat) -> tuple[CommandFormat, ...]:
    """Return the formats that a robot's command is made of: those of its parts, else the format itself."""
    return command_format.parts if isinstance(command_format, PartedCommand) else (command_format,)


def rests_on_joints(command_format: CommandFormat) -> bool:
    """Whether a robot, or a part, without a command stays where its joints are, and not where its command last was."""
    return command_format.holds_position and not command_format.velocities


class PartedCommand:
    """One vector for the policy, one key and one gate for each part (`station.protocols.CommandFormat`).

    A part is a command format of its own, registered under its own name, whose `robot` is that of the whole and the
    part's name: ``quad_legs`` of a ``quad``. So what drives a part finds its gate and what is used of its command
    where it finds those of any robot. It has no key: no writer writes all parts at once.

    Args:
        name: Registered name.
        robot: The robot's.
        parts: In the order of the vector; each element and each joint is in one of them.

    Raises:
        ConfigError: an element is in two parts, two have one name or key, one is called otherwise, or there is but one.
    """

    key, note = "", "its parts have keys of their own"
    holds_position = False

    def __init__(self, name: str, robot: str, parts: Sequence[CommandFormat]) -> None:
        self.name, self.robot, self.parts = name, robot, tuple(parts)
        names = [element.name for part in parts for element in part.elements]
        twice = sorted({each for each in names if names.count(each) > 1})
        if twice:
            raise ConfigError(f"command {name!r}: {', '.join(twice[:4])}: in more than one part")
        odd = [part.robot for part in parts if not part.robot.startswith(f"{robot}_") or not part.key]
        alike = len({part.robot for part in parts}) < len(parts) or len({part.key for part in parts}) < len(parts)
        if odd or alike or len(parts) < 2:
            raise ConfigError(
                f"command {name!r}: expected two parts or more, each with a key and a name of its own, {robot}_PART; "
                f"got {', '.join(part.robot for part in parts) or 'none'}"
            )
        self.default, self.lower, self.upper, self.margin, self.rate = (
            np.concatenate([getattr(part, field) for part in parts])
            for field in ("default", "lower", "upper", "margin", "rate")
        )
        starts = np.cumsum([0, *(len(part.default) for part in parts)]).tolist()
        self._slices = tuple(slice(start, end) for start, end in pairwise(starts))
        self.velocities = tuple(
            start + index for start, part in zip(starts[:-1], parts, strict=True) for index in part.velocities
        )

    @property
    def elements(self) -> tuple[Element, ...]:
        """Those of all parts."""
        return tuple(element for part in self.parts for element in part.elements)

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Those of all parts."""
        return {key: value for part in self.parts for key, value in part.auxiliary.items()}

    @property
    def stock(self) -> StockKeys:
        """No stock program commands a part."""
        return StockKeys()

    def split(self, vector: Floats) -> list[Floats]:
        """Return the vectors of the parts, of one of shape (m,)."""
        return [vector[each] for each in self._slices]

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return what asks all parts for a reference, shape (m,); arms have their default where it is of no joints."""
        return np.concatenate([
            part.default if rests_on_joints(part) and not joint_names else part.encode(reference, joint_names)
            for part in self.parts
        ])  # fmt: skip


def part_name(command_format: PartedCommand, part: CommandFormat) -> str:
    """Return what a part of a robot is called: the end of its keys' suffix."""
    return part.robot.removeprefix(f"{command_format.robot}_")


def by_key(command_format: CommandFormat, vector: Floats) -> dict[str, Floats]:
    """Return what each key of a robot's command is to hold, for one vector of shape (m,)."""
    vectors = command_format.split(vector) if isinstance(command_format, PartedCommand) else [vector]
    return {part.key: each for part, each in zip(parts_of(command_format), vectors, strict=True)}
