"""Command formats by their registered names; one that is for any robot becomes that of the robot that takes it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from station import registry
from station.errors import ConfigError
from station.protocols import CommandFormat, Floats, ForAnyRobot


def command_format(name: str, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
    """Return a format as a robot takes it.

    Args:
        name: Registered name.
        robot: Suffix of the robot's keys; a format that is for one robot has its own.
        lower, upper: Range of each element, shape (m,), of a format for any robot; None for its own.

    Raises:
        UnknownName: it is not registered.
        ConfigError: it is for any robot and none is named, or a range that it cannot have.
    """
    found: CommandFormat = registry.find("command", name)
    if not isinstance(found, ForAnyRobot):
        return found
    if not robot:
        raise ConfigError(f"commands {name!r} are for any robot, and none is named: see `robot_name` of a robot's kind")
    return found.for_robot(robot, lower, upper)


def expect_robot(name: str, robot: str) -> None:
    """Check that a robot is named where a format needs one, for a configuration's ``__post_init__``.

    Raises:
        ValueError: none is where one has to be, or one where the format has its own.
    """
    if (is_for_any := isinstance(registry.find("command", name), ForAnyRobot)) and not robot:
        raise ValueError(
            f"robot: commands {name!r} are for any robot; name the one that takes them, by the end of its keys"
        )
    if robot and not is_for_any:
        raise ValueError(f"robot is {robot!r}: commands {name!r} are for one robot, and need no name of it")


def command_formats(robots: Iterable[str]) -> Iterator[CommandFormat]:
    """Yield every registered format; one that is for any robot as each of some robots takes it, by their names."""
    for name in registry.names("command"):
        found: CommandFormat = registry.find("command", name)
        if isinstance(found, ForAnyRobot):
            yield from (found.for_robot(robot) for robot in dict.fromkeys(robots) if robot)
        else:
            yield found
