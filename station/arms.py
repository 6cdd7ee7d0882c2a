"""What an arm behind a controller of its own is to the rest of the station.

The controller keeps the time, and a session in native code speaks with it; Python hands targets to that session and
reads states from it, and waits for nothing. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, Self

from station.bus import keys
from station.contract import Element, elements, names_of, positions
from station.errors import ConfigError

if TYPE_CHECKING:  # NumPy is loaded where vectors are made: `station doctor` makes none
    from station.protocols import Floats, Reference, StockKeys


def remedy_of(fault: str) -> str:
    """Return what a fault says to do about it (`ArmState.fault`), or ""."""
    return fault.rpartition("; ")[2] if "; " in fault else ""


@dataclass(frozen=True, slots=True, eq=False)
class ArmState:
    """What the session knew at one instant.

    Attributes:
        mono_ns: When it was read, on this machine's monotonic clock [ns].
        q: Joint positions, shape (n,) [rad].
        is_moving: Whether the controller still moves the arm.
        is_engaged: Whether targets are taken: `ArmSession.engage` was granted, and nothing has revoked it since.
        fault: Why the controller takes no commands until somebody clears it, or ""; after its last semicolon what an
            operator does about it.
        why_blocked: Why no target could be taken where the arm is, though nothing is at fault, or "".
        told: The session's own snapshot, for what publishes it.
    """

    mono_ns: int
    q: Floats
    is_moving: bool
    is_engaged: bool
    fault: str
    why_blocked: str
    told: Any


class ArmSession(Protocol):
    """A session with an arm's controller; no call but `clear` waits for anything."""

    @property
    def is_simulated(self) -> bool:
        """Whether this arm is a simulation, which no person can stand beside."""
        ...

    @property
    def lead_rad(self) -> float:
        """How far ahead of the arm a target may be [rad]: what it still goes when nothing more is sent."""
        ...

    def read(self) -> ArmState:
        """Return the newest state."""
        ...

    def engage(self) -> str:
        """Forget old targets and take new ones, from where the joints are; return why not, or ""."""
        ...

    def send(self, q: Floats) -> str:
        """Hand over the newest target, shape (n,) [rad]; return why it was refused, or ""."""
        ...

    def release(self) -> None:
        """Take no more targets: the arm finishes what it has, which is no more than `lead_rad`, and stays there."""
        ...

    def clear(self) -> str:
        """Clear the controller's faults; return why they are not cleared, or "". Takes up to seconds."""
        ...

    def health(self) -> dict[str, Any]:
        """Return what a server's heartbeat tells of the session."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class JointCommand:
    """The command of an arm: absolute positions of its joints [rad] (`station.protocols.CommandFormat`).

    Its arrays are read-only. An arm has no standing to go back to: without a command it stays where it is, and
    `default` only tells the length of the vector and a place within its range. `awaits_pause` is whether its commander
    has to pause once the robot was disarmed before it is followed again.
    """

    name: str
    robot: str
    elements: tuple[Element, ...]
    default: Floats
    lower: Floats
    upper: Floats
    margin: Floats
    rate: Floats
    holds_position: bool = True
    velocities: tuple[int, ...] = ()
    note: str = ""
    stock_key: str = ""
    awaits_pause: bool = True

    @classmethod
    def within(
        cls, name: str, robot: str, joint_names: tuple[str, ...], *, lower: Floats, upper: Floats, margin: Floats,
        rate: Floats, stock_key: str = "", awaits_pause: bool = True,
    ) -> Self:  # fmt: skip
        """Return the command of a robot's n joints, between limits of shape (n,), which are copied.

        Args:
            name: Of the format.
            robot: Suffix of the robot's keys.
            joint_names: Of its joints, in order.
            lower, upper, margin, rate: As in `station.protocols.CommandFormat`.
            stock_key: Bus key that stock programs write it on; "" for the station's own.
            awaits_pause: Whether its commander has to pause after the robot was disarmed.
        """
        import numpy as np

        default = np.clip(np.zeros(len(lower)), lower, upper)
        lower, upper, margin, rate = (np.array(array) for array in (lower, upper, margin, rate))
        for array in (default, lower, upper, margin, rate):
            array.flags.writeable = False
        items = elements((positions(joint_names), "rad"))
        return cls(
            name, robot, items, default, lower, upper, margin, rate, stock_key=stock_key, awaits_pause=awaits_pause
        )

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Nothing goes beside an arm's command."""
        return {}

    @property
    def stock(self) -> StockKeys:
        """No stock program commands an arm."""
        from station.protocols import StockKeys

        return StockKeys()

    @property
    def key(self) -> str:
        """Bus key of the command."""
        return self.stock_key or keys.action_joints(self.robot)

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return the joints of a reference that are the arm's, shape (n,).

        Raises:
            ConfigError: the reference lacks one of them.
        """
        import numpy as np

        wanted = [element.name.removesuffix("_pos") for element in self.elements]
        for name in wanted:
            if name not in joint_names:
                raise ConfigError(f"the motion has no joint {name!r}; the command needs {', '.join(wanted)}")
        return np.array([reference.q[joint_names.index(name)] for name in wanted])

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this command, so that what was sent can be derived again."""
        arrays = {name: getattr(self, name).tolist() for name in ("lower", "upper", "margin", "rate")}
        return {"format": self.name, "key": self.key, "elements": names_of(self.elements), **arrays}
