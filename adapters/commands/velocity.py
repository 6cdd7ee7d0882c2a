"""The velocity of a robot on legs, for any robot: 3 numbers on ``action_velocity_<robot>``, more in its siblings.

| index | element | in |
|---|---|---|
| 0, 1 | velocity of the base, forward and to the left [m/s] | `velocity`, `velocity-height`, `velocity-posture` |
| 2 | yaw rate, turning left [rad/s] | `velocity`, `velocity-height`, `velocity-posture` |
| 3 | height of the base above the ground [m] | `velocity-height`, `velocity-posture` |
| 4, 5, 6 | roll, pitch and yaw of the torso, seen from its upright pose above the base [rad] | `velocity-posture` |

Frame: the heading frame of the base, its yaw alone: x forward, y to the left, z up. Heading and place drift freely.
Where commands are lost velocities end, and a height or posture stays as it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from station.bus import keys
from station.contract import Element, elements
from station.errors import ConfigError
from station.protocols import CommandFormat, Floats, Reference, StockKeys
from station.rotations import roll_pitch_yaw, rotate


class Posture(NamedTuple):
    """An element behind the velocities.

    Attributes:
        name, unit: What it is.
        default: Its value when standing.
        lower, upper: Its range, where no policy says another.
        margin: How far outside it is still clamped.
        rate: Greatest change per second.
    """

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    margin: float
    rate: float


HEIGHT = Posture("root_height", "m", 0.74, 0.24, 0.80, 0.3, 0.5)
"""Of a G1: HOMIE and GR00T stand at 0.74 m, HOMIE was trained down to 0.24 m (docs/velocity.md). The rate is ours."""

TORSO = tuple(Posture(f"torso_{axis}", "rad", 0.0, -0.52, 0.52, 0.5, 1.0) for axis in ("roll", "pitch", "yaw"))
"""No source says what GR00T's policy was trained on; this is how far a G1's waist rolls and pitches."""


def _frozen(values: Sequence[float] | Floats) -> Floats:
    found = np.array(values, dtype=np.float64)
    found.flags.writeable = False
    return found


class VelocityCommand:
    """Implements `station.protocols.CommandFormat` and `ForAnyRobot`; its arrays are read-only.

    Policies were trained on velocities that step. The rates let them, but for a step from end to end.

    Args:
        name: Registered name.
        posture: What is behind the velocities.
        robot: Suffix of the robot's keys; "" for any.
        lower, upper: Range of each element, shape (m,); None for the format's own.

    Raises:
        ConfigError: a range that has no place for standing still.
    """

    auxiliary: Mapping[str, Floats] = MappingProxyType({})
    stock = StockKeys()
    velocities = (0, 1, 2)

    def __init__(
        self,
        name: str = "velocity",
        posture: tuple[Posture, ...] = (),
        *,
        robot: str = "",
        lower: Sequence[float] | Floats | None = None,
        upper: Sequence[float] | Floats | None = None,
    ) -> None:
        self.name, self.robot, self._posture = name, robot, posture
        self.elements: tuple[Element, ...] = (
            *elements((("vx", "vy"), "m/s"), (("wz",), "rad/s")), *(Element(each.name, each.unit) for each in posture),
        )  # fmt: skip
        self.holds_position = bool(posture)
        also = "" if posture else "; heading and place are not commanded"
        self.note = f"heading frame of the base: x forward, y left, z up{also}"
        self.default = _frozen([0, 0, 0, *(each.default for each in posture)])
        self.margin = _frozen([3, 3, 3, *(each.margin for each in posture)])
        self.rate = _frozen([60, 60, 100, *(each.rate for each in posture)])
        self.lower = _frozen([-3, -3, -3, *(each.lower for each in posture)] if lower is None else lower)
        self.upper = _frozen([3, 3, 3, *(each.upper for each in posture)] if upper is None else upper)
        sizes_fit = self.lower.shape == self.upper.shape == self.default.shape
        if not sizes_fit or not ((self.lower <= self.default) & (self.upper >= self.default)).all():
            between = "zero" if not posture else ", ".join(f"{value:g}" for value in self.default)
            raise ConfigError(
                f"commands {self.name!r}: range {self.lower.tolist()} to {self.upper.tolist()}; expected "
                f"{len(self.default)} numbers each, {between} between them"
            )

    @property
    def key(self) -> str:
        """Key of the robot's command; "" of the format for any."""
        return keys.action(f"{self.name}_{self.robot}") if self.robot else ""

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return the format of a robot, within the range that its policy was trained on, shape (m,)."""
        return VelocityCommand(
            self.name, self._posture, robot=robot,
            lower=self.lower if lower is None else lower, upper=self.upper if upper is None else upper,
        )  # fmt: skip

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return the vector that asks for a reference's velocity, shape (m,); its joints are of no use here.

        A reference whose root is at height 0 says none: it stands as high as by default. The torso is upright.
        """
        yaw = roll_pitch_yaw(reference.root_quat_wxyz)[2]
        forward = np.array([np.cos(yaw), np.sin(yaw)])
        linear = rotate(reference.root_quat_wxyz, reference.root_lin_vel)[:2]
        turn = rotate(reference.root_quat_wxyz, reference.root_ang_vel)[2]
        made = self.default.copy()
        made[:3] = forward @ linear, forward[0] * linear[1] - forward[1] * linear[0], turn
        if self._posture and reference.root_pos[2] > 0.0:
            made[3] = reference.root_pos[2]
        return made


FORMAT = VelocityCommand()
WITH_HEIGHT = VelocityCommand("velocity-height", (HEIGHT,))
WITH_POSTURE = VelocityCommand("velocity-posture", (HEIGHT, *TORSO))
FORMATS = {each.name: each for each in (FORMAT, WITH_HEIGHT, WITH_POSTURE)}
"""By their registered names."""
