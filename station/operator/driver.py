"""What a driver is: it turns an operator's input into the robot's command.

A driver knows the robot and no device. It is pure: no bus, no thread, no clock; periods come as arguments. Whether it
may act is not its business: the dead-man's snapshot says so, and without one it brings what it does to an end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import msgspec

from station.operator.deadman import Snapshot
from station.operator.sample import OperatorSample
from station.protocols import CommandFormat, Floats


@dataclass(frozen=True, slots=True, eq=False)
class DriverInput:
    """What a driver makes of a sample before it may act on it.

    Attributes:
        input: The operator's side for the dead-man; None when the sample lacks what the driver needs.
        why_not: What it lacks, or "".
        why_not_engage: Why driving may not begin from here, though it may go on, or "".
    """

    input: Any | None
    why_not: str = ""
    why_not_engage: str = ""


class Driver(Protocol):
    """Turns samples into commands."""

    @property
    def name(self) -> str:
        """Registered name."""
        ...

    @property
    def command_format(self) -> CommandFormat:
        """Format of its commands."""
        ...

    @property
    def mode(self) -> str:
        """What the sticks or the twist move at present; "" for a driver with one mode."""
        ...

    @property
    def target(self) -> Any:
        """The robot's side for the dead-man: what is asked of it at present."""
        ...

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Values of the keys beside the command (hands, neck) after the newest `step`."""
        ...

    @property
    def is_still(self) -> bool:
        """Whether nothing moves by itself any more: a walk that was let go has come to a stand."""
        ...

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """Return what the sample holds for this driver; changes nothing."""
        ...

    def jump(self, before: Any, now: Any) -> str:
        """Return what jumped between two inputs of `inspect`, or ""."""
        ...

    def next_mode(self) -> str:
        """Go to the next mode, return its name."""
        ...

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period [s].

        Args:
            sample: The newest sample; None when there is none that may be used.
            snapshot: The dead-man's while it is engaged; a new object means newly engaged, and the command of that tick
                is the one before it.
            dt_s: The period.

        Returns:
            The command, shape (m,), within its ranges and rates.
        """
        ...

    def resume_from(self, command: Floats) -> None:
        """Go on from a command that came from elsewhere, shape (m,); not while engaged."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this driver: its options."""
        ...


class DriverKind(msgspec.Struct, frozen=True, kw_only=True):
    """What a module registers as a driver.

    Attributes:
        name: Name under which it is found.
        summary: What it does, in a line.
        options: Type of its options.
        make: Makes a driver of options and an operator's name ("" where none is known); imports what is heavy only when
            called, and raises a `station.errors.StationError` that says what is missing.
        rate_hz: Commands per second that its robot expects [Hz].
        moves: A help line per kind of device: which of its controls move what.
    """

    name: str
    summary: str
    options: type[msgspec.Struct]
    make: Callable[[Any, str], Driver]
    rate_hz: float = 50.0
    moves: Mapping[str, str] = {}
