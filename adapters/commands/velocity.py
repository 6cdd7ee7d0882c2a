"""The velocity of a robot on legs: 3 numbers on ``action_velocity_<robot>``, for any robot.

| index | element |
|---|---|
| 0, 1 | velocity of the base, forward and to the left [m/s] |
| 2 | yaw rate, turning left [rad/s] |

Frame: the heading frame of the base, its yaw alone: x forward, y to the left, z up. Heading and place drift freely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from station.bus import keys
from station.contract import elements
from station.errors import ConfigError
from station.protocols import CommandFormat, Floats, Reference, StockKeys
from station.rotations import roll_pitch_yaw, rotate


def _frozen(*values: float) -> Floats:
    found = np.array(values, dtype=np.float64)
    found.flags.writeable = False
    return found


class VelocityCommand:
    """Implements `station.protocols.CommandFormat` and `ForAnyRobot`; its arrays are read-only.

    Policies were trained on velocities that step. The rates let them, but for a step from end to end.

    Args:
        robot: Suffix of the robot's keys; "" for any.
        lower, upper: Range of each element, shape (3,).

    Raises:
        ConfigError: a range that has no place for standing still.
    """

    name = "velocity"
    elements = elements((("vx", "vy"), "m/s"), (("wz",), "rad/s"))
    note = "heading frame of the base: x forward, y left, z up; heading and place are not commanded"
    auxiliary: Mapping[str, Floats] = MappingProxyType({})
    stock = StockKeys()
    velocities = (0, 1, 2)
    holds_position = False
    default, margin, rate = _frozen(0, 0, 0), _frozen(3, 3, 3), _frozen(60, 60, 100)

    def __init__(
        self,
        robot: str = "",
        lower: Sequence[float] | Floats = (-3, -3, -3),
        upper: Sequence[float] | Floats = (3, 3, 3),
    ) -> None:
        self.robot, self.lower, self.upper = robot, _frozen(*lower), _frozen(*upper)
        if not self.lower.shape == self.upper.shape == (3,) or not ((self.lower <= 0) & (self.upper >= 0)).all():
            raise ConfigError(
                f"commands {self.name!r}: range {self.lower.tolist()} to {self.upper.tolist()}; expected 3 numbers "
                "each, zero between them"
            )

    @property
    def key(self) -> str:
        """Key of the robot's command; "" of the format for any."""
        return keys.action(f"{self.name}_{self.robot}") if self.robot else ""

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return the format of a robot, within the range that its policy was trained on, shape (3,)."""
        return VelocityCommand(robot, self.lower if lower is None else lower, self.upper if upper is None else upper)

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return the vector that asks for a reference's velocity, shape (3,); its joints are of no use here."""
        yaw = roll_pitch_yaw(reference.root_quat_wxyz)[2]
        forward = np.array([np.cos(yaw), np.sin(yaw)])
        linear = rotate(reference.root_quat_wxyz, reference.root_lin_vel)[:2]
        turn = rotate(reference.root_quat_wxyz, reference.root_ang_vel)[2]
        return np.array([forward @ linear, forward[0] * linear[1] - forward[1] * linear[0], turn])


FORMAT = VelocityCommand()
