"""A robot twin: a program at the other end of a real robot's cable that is no robot, with faults that can be switched.

A simulated robot (`station.protocols.SimulatedRobot`) is stepped by the control loop itself, so nothing between the two
can fail. A twin is a process of its own with a clock of its own: what a network, a firmware and a battery do is tried
with it before anybody stands beside the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec

from station import config as configs


class Twin(Protocol):
    """A twin that runs."""

    @property
    def period_s(self) -> float:
        """Time between two ticks [s]."""
        ...

    def tick(self) -> None:
        """Advance by a period: hear, move, and say what is measured, on the robot's own network."""
        ...

    def change(self, faults: Any) -> None:
        """Have other faults from now on; of the type that its kind names."""
        ...

    def health(self) -> dict[str, Any]:
        """Return what its heartbeat tells: what it took, what it refused and why, and how it stands."""
        ...

    def close(self) -> None:
        """Leave the network."""
        ...


class TwinKind(msgspec.Struct, frozen=True, kw_only=True):
    """What registers a twin under ``station.twins``; imports nothing heavy.

    Attributes:
        name: Registered name: ``g1``.
        about: What it is, in a line.
        options: Type of its settings.
        faults: Type of what may be wrong with it; each field has a default, with which nothing is.
        make: Returns the twin, on its network; takes its settings and its faults at the start.
        library, extra: Distribution that it needs, and the extra that brings it; "" for none.
    """

    name: str
    about: str
    options: type[msgspec.Struct]
    faults: type[msgspec.Struct]
    make: Callable[[Any, Any], Twin]
    library: str = ""
    extra: str = ""

    def typed_options(self, options: Mapping[str, Any]) -> Any:
        """Return settings as its type has them.

        Raises:
            ValueError: one that it does not have, or of another type.
        """
        return configs.build_options(self.options, options, where=f"options of the twin {self.name}")

    def typed_faults(self, faults: Mapping[str, Any], where: str = "") -> Any:
        """Return faults as its type has them; those that are not named are none.

        Raises:
            ValueError: one that it does not have, or of another type.
        """
        return configs.build_options(self.faults, faults, where=where or f"faults of the twin {self.name}")
