"""Events: what happened, once per change, on the bus and in the log.

Every write of the bus is recorded, so every event stands in the episode it happened in.
"""

from __future__ import annotations

import logging
from typing import Any, Literal

import msgspec

from station.bus import codec
from station.clock import SYSTEM

Severity = Literal["info", "warning", "error"]
_LEVELS: dict[Severity, int] = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """One event.

    Attributes:
        name: What happened, for example ``fall``.
        severity: How bad it is.
        source: Name of the server that says so.
        wall_ns: When, nanoseconds since the Unix epoch.
        detail: Numbers and words that belong to it, units in their names.
    """

    name: str
    severity: Severity
    source: str
    wall_ns: int
    detail: dict[str, Any] = {}

    def encode(self) -> bytes:
        """Return the event as it stands on the bus."""
        return codec.json_object(self)

    def __str__(self) -> str:
        detail = " ".join(f"{name}={_shown(value)}" for name, value in self.detail.items())
        return f"{self.name} {detail}".rstrip()


def make(source: str, name: str, severity: Severity = "info", wall_ns: int | None = None, /, **detail: Any) -> Event:
    """Return an event that happens at an instant of the wall clock [ns]; None for now, by the machine's."""
    wall_ns = SYSTEM.wall_ns() if wall_ns is None else wall_ns
    return Event(name=name, severity=severity, source=source, wall_ns=wall_ns, detail=detail)


def late(event: Event, now_ns: int) -> Event:
    """Return an event that could not be said when it happened, with how late it is by the wall clock [s]."""
    late_s = round((now_ns - event.wall_ns) * 1e-9, 3)
    return msgspec.structs.replace(event, detail={**event.detail, "late_s": late_s})


def decode(data: bytes) -> Event | None:
    """Return the event that bytes from the bus hold, or None when they hold none."""
    try:
        return codec.parse_struct(data, Event)
    except codec.BadValue:
        return None


def write_log(log: logging.Logger, event: Event) -> None:
    """Write an event to a log, at the level of its severity."""
    log.log(_LEVELS[event.severity], "%s", event)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
