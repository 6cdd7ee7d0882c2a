"""How a case went."""

from __future__ import annotations

import math

import msgspec

from station.control.tracking import VelocityFound, VelocityStretch
from station.suite.cases import STILL, Group, Velocity


class FallOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """A fall.

    Attributes:
        at_s: Time since the start of the case [s].
        lean_rad: How far the root leaned [rad].
        contacts: Bodies other than the feet that touched the ground.
        gate: State of the gate.
    """

    at_s: float
    lean_rad: float
    contacts: tuple[str, ...]
    gate: str

    def __str__(self) -> str:
        touched = f", {' and '.join(self.contacts)} on the ground" if self.contacts else ""
        return f"fell at {self.at_s:.2f} s ({self.gate}, leaned {math.degrees(self.lean_rad):.0f}°{touched})"


class Drift(msgspec.Struct, frozen=True, kw_only=True):
    """How far a robot that was to stand went from where it stood once it had settled.

    Attributes:
        end_m, greatest_m: Distance of the root in the plane, at the end and at most [m].
        yaw_rad: How far it turned in the end [rad].
    """

    end_m: float
    greatest_m: float
    yaw_rad: float


class Trace(msgspec.Struct, frozen=True, kw_only=True):
    """What a picture of a walk shows.

    Attributes:
        times_s: n instants [s].
        commanded, measured: Velocities at each, as `station.control.tracking.VelocityTracking.curves` has them.
        path: Places of the root in the plane, from where it began, as often per second [m].
    """

    times_s: list[float]
    commanded: list[list[float]]
    measured: list[list[float]]
    path: list[list[float]]


class Ceased(msgspec.Struct, frozen=True, kw_only=True):
    """What became of the velocity that was let through, when commands ceased.

    Attributes:
        zero_after_s: Time from the last command until it was zero [s]; infinite where it never was.
        greatest_step: Its greatest change in a tick meanwhile, as a share of what was commanded.
    """

    zero_after_s: float
    greatest_step: float


class TurnsTaken(msgspec.Struct, frozen=True, kw_only=True):
    """How policies handed over to each other.

    Attributes:
        count: How often one took over.
        refusal: Why one did not, the newest; "" where each did.
        target_step: As that of an `Outcome`, while they handed over.
        target_step_else: Likewise, while one drove alone.
    """

    count: int
    refusal: str
    target_step: float
    target_step_else: float


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How a case went.

    Attributes:
        case: Its name.
        group: Its group.
        falls: In order; the first ends most cases.
        joint_error_rad: Mean joint error of the ticks that count (`station.control.tracking`); None when none did.
        lean_rad: How far the root leaned at most [rad].
        drift: Of a robot that was asked to stand and did not fall, else None.
        target_step: Greatest way of a joint's target from one tick to the next, as a share of how far the joint can
            move in it.
        asked: The velocity that was commanded for a while; zero where none was.
        velocity: How velocities were followed (`station.control.tracking`); None where none was commanded.
        trace: Its curves, and the path.
        ceased: What became of the command where commands ceased.
        turns: How policies handed over, where they did.
        simulated_s: Simulated time [s].
        wall_s: Time that it took [s].
    """

    case: str
    group: Group
    falls: tuple[FallOutcome, ...]
    joint_error_rad: float | None
    lean_rad: float
    drift: Drift | None
    simulated_s: float
    wall_s: float
    target_step: float = 0.0
    asked: Velocity = STILL
    velocity: VelocityFound | None = None
    trace: Trace | None = None
    ceased: Ceased | None = None
    turns: TurnsTaken | None = None

    @property
    def stretch(self) -> VelocityStretch | None:
        """The longest stretch of the velocity that was asked for; None where it was not followed for long enough."""
        stretches = self.velocity.stretches if self.velocity is not None else ()
        mine = [each for each in stretches if each.commanded == self.asked]
        return max(mine, key=lambda each: each.seconds, default=None)
