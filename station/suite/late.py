"""A simulated robot that hears its targets late: the time that a network and a bus of motors take."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from station.protocols import Fall, Floats, JointTargets, RobotState, SimulatedRobot

_ROUNDING = 1e-9


def periods(late_s: float, period_s: float) -> int:
    """Return the fewest control periods that are at least so long [s]."""
    return math.ceil(late_s / period_s - _ROUNDING)


class LateRobot:
    """Implements `station.protocols.SimulatedRobot` around another.

    Args:
        robot: Moves when it hears.
        periods: How many control periods later; until then it follows the first targets.
    """

    def __init__(self, robot: SimulatedRobot, periods: int) -> None:
        self._robot, self._periods = robot, periods
        self._under_way: deque[JointTargets] = deque()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """As of the robot."""
        return self._robot.joint_names

    @property
    def joint_speeds(self) -> Floats:
        """As of the robot."""
        return self._robot.joint_speeds

    def read(self) -> RobotState:
        """Return the newest measurement; only targets are late."""
        return self._robot.read()

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets; return those that are applied now."""
        self._under_way.append(targets)
        has_come = len(self._under_way) > self._periods
        return self._robot.write(self._under_way.popleft() if has_come else self._under_way[0])

    def damp(self) -> None:
        """Damp the robot, at once."""
        self._robot.damp()

    def reset(self) -> None:
        """Put the robot back on its feet; nothing is under way to it."""
        self._under_way.clear()
        self._robot.reset()

    def push(self, velocity_step: Floats) -> None:
        """Push the robot, at once."""
        self._robot.push(velocity_step)

    def fallen(self) -> Fall | None:
        """Return why the robot counts as fallen."""
        return self._robot.fallen()

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of the robot."""
        return {**self._robot.facts(), "targets_late_periods": self._periods}

    def close(self) -> None:
        """Close the robot."""
        self._robot.close()
