"""The command of a G1 that walks or tracks: velocities and a motion, apart; the policy that drives listens to its own.

| part | command | key, of the robot ``g1_29`` |
|---|---|---|
| ``walk`` | `velocity` | ``action_velocity_g1_29_walk`` |
| ``track`` | `g1-motion`: the 35 numbers of `adapters.commands.twist2` | ``action_motion_g1_29_track`` |
"""

from __future__ import annotations

from dataclasses import fields, replace

from adapters.commands import twist2, velocity
from adapters.commands.body import BodyCommand
from station.bus import keys
from station.parts import PartedCommand
from station.protocols import CommandFormat, Floats, StockKeys

WALK = slice(0, 3)
TRACK = slice(3, 3 + len(twist2.FORMAT.default))
"""Where each part is in the whole."""


class MotionCommand(BodyCommand):
    """TWIST2's numbers under keys that no stock program writes, for any G1 (`station.protocols.ForAnyRobot`)."""

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return it as one robot takes it; its range is always its own."""
        return replace(self, robot=robot, key=keys.action(f"motion_{robot}"))


_OWN = {"name": "g1-motion", "robot": "", "key": "", "auxiliary": {}, "stock": StockKeys()}
MOTION = MotionCommand(**{each.name: getattr(twist2.FORMAT, each.name) for each in fields(BodyCommand)} | _OWN)


def motion_of(robot: str) -> CommandFormat:
    """Return TWIST2's numbers as a robot's part takes them, by its name; "" for the robot that TWIST2 knows."""
    return MOTION.for_robot(robot) if robot else twist2.FORMAT


class WalkOrTrack(PartedCommand):
    """As `PartedCommand`; the range of the velocities is that of the policy that walks.

    Args:
        robot: Suffix of the robot's keys; "" for any.
        lower, upper: Range of each element, shape (38,), of which that of the velocities counts; None for its own.
    """

    def __init__(self, robot: str = "", lower: Floats | None = None, upper: Floats | None = None) -> None:
        of_walk = (None if end is None else end[WALK] for end in (lower, upper))
        walk = velocity.FORMAT.for_robot(f"{robot}_walk", *of_walk)
        super().__init__("g1-walk-track", robot, (walk, MOTION.for_robot(f"{robot}_track")))

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return the format of a robot, within a range of shape (38,)."""
        return WalkOrTrack(robot, lower, upper)


FORMAT = WalkOrTrack()
