"""Who lives on the bus that an episode is to be replayed to, and what may be replayed there."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import get_args

from station.bus import keys
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.contract import Role
from station.errors import Refused, UnknownName
from station.life.server import Health, read_configurations, read_health

_LISTEN_S = 0.3  # six periods of a 20 Hz writer: who drives a robot is heard within
COMMANDS = frozenset({"command"})
ROLES: tuple[str, ...] = (*get_args(Role), "unknown")
"""Every role that a key may have; ``unknown`` for a key without contract."""


@dataclass(frozen=True)
class Target:
    """Who lives on a bus.

    Attributes:
        robots: Low-level servers, and state keys that somebody writes without being one of our servers.
        commanders: Command servers, and command keys that somebody writes.
        others: Recorders and sensors.
    """

    robots: tuple[str, ...] = ()
    commanders: tuple[str, ...] = ()
    others: tuple[str, ...] = ()

    @property
    def is_driven(self) -> bool:
        """Whether a robot, real or simulated, takes commands from this bus."""
        return bool(self.robots)

    @property
    def is_empty(self) -> bool:
        """Whether nobody lives there."""
        return not (self.robots or self.commanders or self.others)


def look_at(bus: Bus) -> Target:
    """Return who lives on a bus: by heartbeats, and by what stock scripts without one write within a moment."""
    alive = [health for health in read_health(bus) if health.is_alive and not _is_replayed(bus, health)]
    written = _written_now(bus)
    by_role: dict[str, list[str]] = {"low-level": [], "command": []}
    others: list[str] = []
    for health in alive:
        by_role.get(health.role, others).append(health.name)
    return Target(
        robots=tuple(by_role["low-level"] or written["state"]),
        commanders=tuple(by_role["command"] or written["command"]),
        others=tuple(others),
    )


def roles_for(
    target: Target, wanted: Collection[str] | None, *, allow_live: bool, speed: float
) -> frozenset[str] | None:
    """Return the roles to replay, None for everything.

    Raises:
        Refused: a robot lives there and that is not allowed, or somebody else commands it.
        UnknownName: no such role.
    """
    for role in wanted or ():
        if role not in ROLES:
            raise UnknownName("role", role, ROLES)
    if target.commanders:
        raise Refused(
            f"replay: {', '.join(target.commanders)} is writing commands on this bus, and two writers of one command "
            "key throw a robot about; stop it first"
        )
    if target.is_driven:
        return _for_a_robot(target, wanted, allow_live=allow_live, speed=speed)
    if wanted is not None:
        return frozenset(wanted)
    # A recorder would obey a recorded request to record; on an empty bus nobody obeys.
    return None if target.is_empty else frozenset(ROLES) - {"control"}


def _for_a_robot(target: Target, wanted: Collection[str] | None, *, allow_live: bool, speed: float) -> frozenset[str]:
    who = ", ".join(target.robots)
    if not allow_live:
        raise Refused(
            f"replay: a robot is driven on this bus ({who}) and would move; clear its surroundings and allow it, "
            "or replay to another bus"
        )
    if speed > 1.0:
        raise Refused(f"replay: speed {speed:g} to a robot that is driven ({who}); expected at most 1")
    roles = frozenset(wanted) if wanted is not None else COMMANDS
    if roles - COMMANDS:
        raise Refused(
            f"replay: roles {', '.join(sorted(roles - COMMANDS))} to a bus where {who} writes its own; "
            "only commands may be replayed to a robot"
        )
    return roles


def _written_now(bus: Bus) -> dict[str, list[str]]:
    """Return the state and command keys that are written while we listen."""
    suspects = {
        item.key: item.role for item in Contracts(read_configurations(bus)).all() if item.role in ("state", "command")
    }
    written: dict[str, list[str]] = {"state": [], "command": []}
    with bus.watch(list(suspects)) as watch:
        bus.clock.sleep(_LISTEN_S)
        for key, role in suspects.items():
            sample = watch.latest(key)
            if sample is not None and sample.arrived_ns is not None:
                written[role].append(key)
    return written


def _is_replayed(bus: Bus, health: Health) -> bool:
    """Whether a heartbeat was put there by a replay: it names the server that was recorded, not who wrote it."""
    key = keys.server(health.name)
    sample = bus.read([key]).get(key)
    return sample is None or sample.stamp is None or sample.stamp.source != health.source
