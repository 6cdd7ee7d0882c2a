"""How a case went."""

from __future__ import annotations

import math

import msgspec

from station.suite.cases import Group


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


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How a case went.

    Attributes:
        case: Its name.
        group: Its group.
        falls: In order; the first ends most cases.
        joint_error_rad: Mean joint error of the ticks that count (`station.control.tracking`); None when none did.
        lean_rad: How far the root leaned at most [rad].
        drift: Of a robot that was asked to stand and did not fall, else None.
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
