"""The driver `glove`: the fingers of a robot's hand bend as those in a glove do, or as those that a headset sees.

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
from adapters.devices.glove.sensors import PRESETS, why_not
from adapters.retarget import finger_bends
from station import registry
from station.errors import ConfigError
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample
from station.protocols import Floats

GENTLE_RAD_S = 1.5
"""Speed of a joint from engaging until it has met its finger."""

_MET_RAD = 0.05
_JUMP = 0.7  # of the whole way, between two samples: no finger is that fast, a cable that breaks is


class GloveOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the driver `glove`.

    Attributes:
        command: Registered format of the hand's command: ``g1-left-hand``.
        sensors: What each sensor of the glove is, in the glove's order (`adapters.devices.glove.sensors`), as `station
            devices calibrate glove` named them; none for the usual names of 5 or 15.
        speed_rad_s: Greatest speed of a joint [rad/s].
    """

    command: str
    sensors: tuple[str, ...] = ()
    speed_rad_s: float = 8.0

    def __post_init__(self) -> None:
        registry.expect("command", self.command)
        if self.sensors and (why := why_not(self.sensors)):
            raise ValueError(f"sensors: {why}")
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
        known = [options.sensors] if options.sensors else PRESETS.values()
        self._weights = {names: weights(found, names) for names in known}
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
        closed = self._closed(sample)
        if closed is None:
            return DriverInput(None, f"neither a glove's sensors nor a tracked {self.command_format.side} hand comes")
        if self._names(closed) is None or not np.isfinite(closed).all():
            expected = " or ".join(str(len(names)) for names in self._weights)
            return DriverInput(
                None,
                f"the glove sends {len(closed)} sensors, expected {expected} numbers; say with sensors: what each is",
            )
        return DriverInput(np.clip(closed, 0.0, 1.0))

    def jump(self, before: Floats, now: Floats) -> str:
        """Return which sensor jumped, or ""."""
        names = self._names(now)
        if names is None or len(before) != len(now):
            return f"the glove sends {len(now)} sensors and no more {len(before)}"
        change = np.abs(now - before)
        worst = int(change.argmax())
        if change[worst] <= _JUMP:
            return ""
        way = f"{change[worst]:.2f} of its whole way"
        return f"{names[worst]} of the glove jumped by {way} between two samples (limit {_JUMP:g})"

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
        hand, names = self.command_format, self._names(closed)
        if names is None:
            return
        missing = hand.opened + (hand.closed - hand.opened) * (self._weights[names] @ closed) - self._q
        self._met |= np.abs(missing) < _MET_RAD
        change = np.where(self._met, self._fastest, np.minimum(GENTLE_RAD_S, self._fastest)) * dt_s
        self._q = self._q + np.clip(missing, -change, change)

    def _closed(self, sample: OperatorSample) -> Floats | None:
        """Return what a glove sends, else how far the fingers of a tracked hand are closed."""
        if sample.joints is not None:
            return sample.joints
        hand = sample.hands.get(self.command_format.side)
        return None if hand is None else finger_bends.closed(hand)

    def _names(self, closed: Floats) -> tuple[str, ...] | None:
        """Return what the sensors are called, as many as there are numbers."""
        return next((names for names in self._weights if len(names) == len(closed)), None)


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
