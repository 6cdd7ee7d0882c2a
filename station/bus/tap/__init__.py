"""Every write of the bus, in order and byte for byte, by any writer and any command."""

from __future__ import annotations

import logging
from collections.abc import Callable

from station.bus.address import BusAddress
from station.bus.tap.base import Position, Tap, TapRefused, Write, why_not_resumed
from station.bus.tap.notifications import NotificationTap
from station.bus.tap.poll import PollTap
from station.bus.tap.replication import ReplicationTap
from station.errors import BusError, UnknownName

__all__ = ["BACKENDS", "Position", "Tap", "TapRefused", "Write", "open_tap", "why_not_resumed"]

log = logging.getLogger(__name__)

BACKENDS: dict[str, Callable[[BusAddress, Position | None], Tap]] = {
    "replication": ReplicationTap,
    "notifications": NotificationTap,
    "poll": PollTap,
}
"""From the best to the last resort."""


def open_tap(address: BusAddress, *, resume: Position | None = None, backend: str | None = None) -> Tap:
    """Open the best tap that the server allows; it is armed: whatever is written after this returns is seen.

    Args:
        address: The bus; only its database is tapped.
        resume: Go on behind this position of an earlier tap; `Tap.resumed` tells whether that was possible.
        backend: Take this one of `BACKENDS` or none.

    Raises:
        UnknownName: there is no such backend.
        BusError: the bus cannot be reached, or allows none of what was tried.
    """
    if backend is not None and backend not in BACKENDS:
        raise UnknownName("tap backend", backend, BACKENDS)
    refusals: list[str] = []
    for name in [backend] if backend is not None else BACKENDS:
        try:
            tap = BACKENDS[name](address, resume)
        except TapRefused as refusal:
            refusals.append(str(refusal))
            continue
        if refusals:
            log.warning("writes may be missed: tapping by %s, because %s", name, "; ".join(refusals))
        return tap
    raise BusError(f"bus {address} cannot be tapped: {'; '.join(refusals)}")
