"""The driver `velocity`: sticks, keys or a twist say how fast a robot on legs goes, turns, and how high it stands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from adapters.commands.velocity import FORMAT, FORMATS
from adapters.drivers.sticks import HEIGHT_RATE, deflections, live
from station.blends import VELOCITY_FADE_S
from station.errors import did_you_mean
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample
from station.protocols import CommandFormat, Floats

RISES_S = 0.5
"""From standing to full speed; a key goes down at once [s]."""

_ROUNDING = 1e-9


class VelocityOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the driver `velocity`.

    Attributes:
        robot: Which robot it commands, by the end of its keys: ``go2``.
        forward_mps, left_mps, turn_rad_s: Speeds at full deflection [m/s, m/s, rad/s]; its robot clamps what its policy
            was not trained on.
        format: The command format: ``velocity``, or one with a height, which the right stick raises and lowers, a pedal
            as such a stick, or a twist up and down; it stays where it was left.
    """

    robot: str
    format: str = FORMAT.name
    forward_mps: float = 0.7
    left_mps: float = 0.4
    turn_rad_s: float = 0.8

    def __post_init__(self) -> None:
        if not self.robot:
            raise ValueError("robot is empty; expected the end of the keys of the robot that takes the velocities")
        if self.format not in FORMATS:
            raise ValueError(
                f"format is {self.format!r}{did_you_mean(self.format, [*FORMATS])}; expected {', '.join(FORMATS)}"
            )
        for name in ("forward_mps", "left_mps", "turn_rad_s"):
            if not 0.0 <= getattr(self, name) <= 3.0:
                raise ValueError(f"{name} is {getattr(self, name):g}; expected 0 to 3")


class VelocityDriver:
    """Implements `station.operator.driver.Driver`."""

    name = "velocity"
    mode = ""
    auxiliary: Mapping[str, Floats] = FORMAT.auxiliary

    def __init__(self, options: VelocityOptions) -> None:
        self._options = options
        self.command_format: CommandFormat = FORMATS[options.format].for_robot(options.robot)
        self._fastest = np.array([options.forward_mps, options.left_mps, options.turn_rad_s])
        self._velocity: Floats = np.zeros(3)
        self._span = self._fastest  # how far it may be from zero
        self._posture: Floats = self.command_format.default[3:].copy()
        self._held: Snapshot[Any, Any] | None = None

    @property
    def target(self) -> None:
        """Velocities are counted from zero."""
        return

    @property
    def is_still(self) -> bool:
        """Whether it asks the robot to stand."""
        return not self._velocity.any()

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """A twist will do, or any controls."""
        if (twist := _twist(sample)) is not None:
            return DriverInput(twist)
        return DriverInput(sample.controls) if sample.controls else DriverInput(None, "the device sends no controls")

    def jump(self, before: Any, now: Any) -> str:
        """Sticks do not jump."""
        return ""

    def next_mode(self) -> str:
        """There is but one."""
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot velocities fade as they do where commands are lost."""
        wanted, takes_s = np.zeros(3), VELOCITY_FADE_S
        if snapshot is not None and snapshot is self._held:
            takes_s = RISES_S
            if sample is not None:
                *velocity, up = _deflected(sample)
                wanted = self._fastest * velocity
                self._raise(HEIGHT_RATE * up * dt_s)
        elif snapshot is not None:  # newly engaged: the command before it
            wanted = self._velocity
        self._held = snapshot
        change = self._span * dt_s / takes_s
        missing = wanted - self._velocity
        self._velocity = np.where(
            np.abs(missing) <= change + _ROUNDING, wanted, self._velocity + np.sign(missing) * change
        )
        return np.concatenate([self._velocity, self._posture])

    def resume_from(self, command: Floats) -> None:
        """Start from a command that another writer gave, shape (m,)."""
        command = np.clip(command, self.command_format.lower, self.command_format.upper)
        self._velocity, self._posture = command[:3], command[3:].copy()
        self._span = np.maximum(self._fastest, np.abs(self._velocity))

    def _raise(self, by_m: float) -> None:
        """Change the height, the first number behind the velocities, within its range."""
        lower, upper = self.command_format.lower[3:4], self.command_format.upper[3:4]
        self._posture[:1] = np.clip(self._posture[:1] + by_m, lower, upper)

    def facts(self) -> dict[str, Any]:
        """Name and options."""
        return {"driver": self.name, **msgspec.to_builtins(self._options)}


def _twist(sample: OperatorSample) -> Floats | None:
    return sample.twist if sample.twist is not None and np.isfinite(sample.twist).all() else None


def _deflected(sample: OperatorSample) -> Floats:
    """Return deflections from -1 to 1: forward, to the left, turning left, up."""
    if (twist := _twist(sample)) is not None:
        return np.clip(twist[[0, 1, 5, 2]], -1.0, 1.0)
    return np.array([live(each) for each in deflections(sample.controls)])
