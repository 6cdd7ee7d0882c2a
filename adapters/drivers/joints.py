"""The driver `joints`: joints of a leader arm become joints of the robot; the legs stand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.drivers.body_on_legs import BodyOnLegs, named
from adapters.retarget.arm_ik import ARMS, FASTEST_RAD_S
from adapters.robots.g1 import joints as g1
from station.errors import did_you_mean
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample, Side
from station.protocols import CommandFormat, Floats

APART_RAD = 0.8
"""A leader farther from its follower may not begin to drive it; as in GELLO."""

GENTLE_RAD_S = 0.6
"""Speed of a joint from engaging until it has caught up with its leader."""

_CAUGHT_UP_RAD = 0.05
_JUMP_RAD = 0.8  # between two samples; a servo that restarts comes back a turn off


class JointsOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the driver `joints`.

    Attributes:
        joints: Which joint of the robot each joint of the leader drives, in the leader's order.
        grippers: The hands that the values after the joints close: 0 open, 1 closed.
    """

    joints: tuple[str, ...] = tuple(ARMS[:7])
    grippers: tuple[Side, ...] = ()

    def __post_init__(self) -> None:
        for name in self.joints:
            if name not in ARMS:
                raise ValueError(f"joints: no joint {name!r}{did_you_mean(name, ARMS)}; expected joints of the arms")
        if not self.joints or len(set(self.joints)) < len(self.joints):
            raise ValueError(f"joints is {list(self.joints)}; expected each joint once, and at least one")


class Difference(NamedTuple):
    """How far a leader's joint is from the robot's [rad]: moving the leader by `move` brings them together."""

    joint: str
    leader: float
    robot: float

    @property
    def move(self) -> float:
        """What the leader's joint is to be moved by [rad]."""
        return self.robot - self.leader


class JointsDriver:
    """Implements `station.operator.driver.Driver`."""

    name = "joints"
    mode = ""

    def __init__(self, options: JointsOptions | None = None) -> None:
        self._options = options or JointsOptions()
        self._body = BodyOnLegs()
        names = self._options.joints
        self._lower, self._upper = g1.lower(names), g1.upper(names)
        self._fastest = np.minimum(g1.velocity(names), FASTEST_RAD_S)
        self._held: Snapshot[Any, Any] | None = None
        self._caught_up = np.zeros(len(names), dtype=bool)
        self.resume_from(FORMAT.default)

    @property
    def command_format(self) -> CommandFormat:
        """TWIST2's."""
        return FORMAT

    @property
    def target(self) -> Floats:
        """Joints that are asked for, in the leader's order [rad]."""
        return self._q.copy()

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Both Dex3 hands, and the neck at rest."""
        return self._body.auxiliary

    @property
    def is_still(self) -> bool:
        """The legs always stand."""
        return self._body.is_standing

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """As many joints as configured are needed, each near the robot's for a beginning."""
        count = len(self._options.joints) + len(self._options.grippers)
        joints = sample.joints
        if joints is None:
            return DriverInput(None, "the leader sends no joints")
        if len(joints) != count or not np.isfinite(joints).all():
            return DriverInput(None, f"the leader sends {len(joints)} values, expected {count} numbers")
        far = [found for found in self.differences(joints) if abs(found.move) > APART_RAD]
        told = ", ".join(f"{found.joint} by {found.move:+.2f}" for found in far)
        return DriverInput(
            joints, why_not_engage=f"leader is too far from the robot; move it (rad): {told}" if far else ""
        )

    def differences(self, leader: Floats) -> list[Difference]:
        """Return where each joint of leader and robot is, for the operator who brings them together."""
        pairs = zip(self._options.joints, leader.tolist(), self._q.tolist(), strict=False)
        return [Difference(*pair) for pair in pairs]

    def jump(self, before: Floats, now: Floats) -> str:
        """Return which joint jumped, or ""."""
        count = len(self._options.joints)
        change = np.abs(now[:count] - before[:count])
        worst = int(change.argmax())
        if change[worst] <= _JUMP_RAD:
            return ""
        return f"{self._options.joints[worst]} jumped {change[worst]:.2f} rad between two samples (limit {_JUMP_RAD:g})"

    def next_mode(self) -> str:
        """There is but one."""
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot the arms stay."""
        if snapshot is not self._held:
            self._held = snapshot
            self._caught_up[:] = False
            if snapshot is not None:
                return self._body.begin()
        elif snapshot is not None and sample is not None and sample.joints is not None:
            self._follow(sample.joints, dt_s)
        arms = named(ARMS, self._arms) | named(self._options.joints, self._q)
        return self._body.send(self._body.sticks.rest(), dt_s, arms)

    def resume_from(self, command: Floats) -> None:
        """Start from a command that another writer gave, shape (m,)."""
        self._body.resume_from(command)
        self._q, self._arms = self._body.joints(self._options.joints), self._body.joints(ARMS)

    def facts(self) -> dict[str, Any]:
        """Name and options."""
        return {"driver": self.name, **msgspec.to_builtins(self._options)}

    def _follow(self, leader: Floats, dt_s: float) -> None:
        """Go to the leader, gently at first, each joint as fast as it can once it has met its own."""
        count = len(self._options.joints)
        missing = np.clip(leader[:count], self._lower, self._upper) - self._q
        self._caught_up |= np.abs(missing) < _CAUGHT_UP_RAD
        change = np.where(self._caught_up, self._fastest, np.minimum(GENTLE_RAD_S, self._fastest)) * dt_s
        self._q = self._q + np.clip(missing, -change, change)
        for side, closed in zip(self._options.grippers, leader[count:].tolist(), strict=True):
            self._body.fingers.follow(side, min(max(closed, 0.0), 1.0), dt_s)
