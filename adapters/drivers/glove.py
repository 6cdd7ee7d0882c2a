"""The driver `glove`: the fingers of a robot's hand bend as those in a glove do.

A glove tells of each sensor how far it is closed, a hand's command tells of each joint what bends it and where it is
open and closed (`adapters.commands.hand.HandCommand`): so any glove drives any hand. A joint goes to its finger gently
from engaging until it has met it, then as fast as it is allowed to; let go, the hand stays as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from adapters.commands.hand import HandCommand
from station import registry
from station.errors import ConfigError
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample
from station.protocols import Floats

FINGERS = ("thumb", "index", "middle", "ring", "little")

GENTLE_RAD_S = 1.5
"""Speed of a joint from engaging until it has met its finger."""

_MET_RAD = 0.05
_JUMP = 0.7  # of the whole way, between two samples: no finger is that fast, a cable that breaks is


class GloveOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the driver `glove`.

    Attributes:
        command: Registered format of the hand's command: ``g1-left-hand``.
        sensors: What each sensor of the glove is, in the glove's order: a finger or a part of one, ``index_0`` for the
            knuckle of the index finger, ``index_1`` for the next joint; ``thumb_rotation``. `station devices calibrate
            glove` names them.
        speed_rad_s: Greatest speed of a joint [rad/s].
    """

    command: str
    sensors: tuple[str, ...] = FINGERS
    speed_rad_s: float = 8.0

    def __post_init__(self) -> None:
        registry.expect("command", self.command)
        odd = [name for name in self.sensors if name.partition("_")[0] not in FINGERS]
        if odd:
            raise ValueError(
                f"sensors: {', '.join(odd[:4])} belongs to no finger; expected {', '.join(FINGERS)}, or …_0"
            )
        if not self.sensors or len(set(self.sensors)) < len(self.sensors):
            raise ValueError(f"sensors is {list(self.sensors)}; expected each sensor once, and at least one")
        if not 0.1 <= self.speed_rad_s <= 20.0:
            raise ValueError(f"speed_rad_s is {self.speed_rad_s:g}; expected 0.1 to 20")


class GloveDriver:
    """Implements `station.operator.driver.Driver`.

    Raises:
        ConfigError: the command is no hand's, or no sensor bends some of its joints.
    """

    name = "glove"
    mode = ""
    is_still = True
    auxiliary: Mapping[str, Floats] = {}

    def __init__(self, options: GloveOptions) -> None:
        found = registry.find("command", options.command)
        if not isinstance(found, HandCommand):
            raise ConfigError(f"command {options.command!r} is not that of a hand, and a glove drives nothing else")
        self._options, self.command_format = options, found
        self._weights = weights(found, options.sensors)
        self._fastest = np.minimum(found.rate, options.speed_rad_s)
        self._held: Snapshot[Any, Any] | None = None
        self._met = np.zeros(len(found.default), dtype=bool)
        self._q: Floats = found.opened.copy()

    @property
    def target(self) -> Floats:
        """Joints that are asked for, shape (n,) [rad]."""
        return self._q.copy()

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """A number of each sensor is needed."""
        names, closed = self._options.sensors, sample.joints
        if closed is None:
            return DriverInput(None, "the glove sends no sensors")
        if len(closed) != len(names) or not np.isfinite(closed).all():
            return DriverInput(
                None,
                f"the glove sends {len(closed)} sensors, expected {len(names)} numbers: {', '.join(names)}; set "
                "sensors: to what it has",
            )
        return DriverInput(np.clip(closed, 0.0, 1.0))

    def jump(self, before: Floats, now: Floats) -> str:
        """Return which sensor jumped, or ""."""
        change = np.abs(now - before)
        worst = int(change.argmax())
        if change[worst] <= _JUMP:
            return ""
        return (
            f"{self._options.sensors[worst]} of the glove jumped by {change[worst]:.2f} of its whole way between two "
            f"samples (limit {_JUMP:g})"
        )

    def next_mode(self) -> str:
        """There is but one."""
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot the hand stays."""
        if snapshot is not self._held:
            self._held = snapshot
            self._met[:] = False
        elif snapshot is not None and sample is not None:
            closed = self.inspect(sample).input
            if closed is not None:
                self._follow(closed, dt_s)
        return self._q.copy()

    def resume_from(self, command: Floats) -> None:
        """Go on from where the hand is, shape (n,) [rad]."""
        self._q = np.array(command)

    def facts(self) -> dict[str, Any]:
        """Name and options."""
        return {"driver": self.name, **msgspec.to_builtins(self._options)}

    def _follow(self, closed: Floats, dt_s: float) -> None:
        hand = self.command_format
        missing = hand.opened + (hand.closed - hand.opened) * (self._weights @ closed) - self._q
        self._met |= np.abs(missing) < _MET_RAD
        change = np.where(self._met, self._fastest, np.minimum(GENTLE_RAD_S, self._fastest)) * dt_s
        self._q = self._q + np.clip(missing, -change, change)


def weights(hand: HandCommand, sensors: Sequence[str]) -> Floats:
    """Return how much of each joint's bending each sensor says, shape (n joints, n sensors); a row adds up to 1.

    A joint follows the sensor of its name, else the one of its whole finger, else the mean of those of its finger. One
    that nothing bends between open and closed follows none: its row is zero.

    Raises:
        ConfigError: a joint that bends has no sensor.
    """
    made = np.zeros((len(hand.fingers), len(sensors)))
    for row, wanted, way in zip(made, hand.fingers, hand.closed - hand.opened, strict=True):
        finger = wanted.partition("_")[0]
        of_finger = [name for name in sensors if name.startswith(f"{finger}_") and not name.endswith("_rotation")]
        found = next(([name] for name in (wanted, finger) if name in sensors), of_finger)
        if not found and way:
            raise ConfigError(
                f"sensors: none of {', '.join(sensors)} bends {wanted} of {hand.name!r}; expected one called "
                f"{wanted} or {finger}"
            )
        for name in found:
            row[sensors.index(name)] = 1.0 / len(found)
    return made
