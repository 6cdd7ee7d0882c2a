"""What a station is doing now: servers, keys, writers."""

from __future__ import annotations

import io
from typing import Any, get_args

import msgspec
from rich.console import Console, Group, RenderableType

from station.bus import clocks
from station.bus import stamp as stamps
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.contract import Role
from station.life import stop_file
from station.life.server import Health, read_configurations, read_health
from station.life.stop_file import LatchedStop
from station.view.rates import KeyRate, RateMeter
from station.view.table import WIDE, Column, age_s, plain, render_servers, state_of, table_of

_LOOK_S = 1.0
_ROLES = get_args(Role)


class KeyStatus(msgspec.Struct, frozen=True):
    """A key of the bus.

    Attributes:
        key, role, writer: The key, what it is to a station, and its last writer (``foreign`` without a stamp).
        rate_hz: Writes per second [Hz].
        age_s: Time since the last write [s]; for a key that was not written while we looked, by its stamp, else None.
    """

    key: str
    role: str
    writer: str
    rate_hz: float
    age_s: float | None


class Status(msgspec.Struct, frozen=True):
    """A whole station."""

    address: str
    servers: list[Health]
    keys: list[KeyStatus]
    stop: LatchedStop | None = None

    def to_plain(self) -> dict[str, Any]:
        """Return plain values: ``{"stop": null or {"reason", …}, "servers": [{"name", "state", "pid", …}], "keys":
        [{"key", "rate_hz", …}]}``."""
        servers = [
            msgspec.to_builtins(health) | {"state": state_of(health), "age_s": age_s(health)} for health in self.servers
        ]
        stop = msgspec.to_builtins(self.stop)
        return {"address": self.address, "stop": stop, "servers": servers, "keys": msgspec.to_builtins(self.keys)}


def read_status(bus: Bus, meter: RateMeter) -> Status:
    """Return the status of a station whose writes a meter has been counting."""
    rates, described = meter.rates(), Contracts(read_configurations(bus))
    found, marks = [], bus.stamps(bus.names())
    elsewhere = {stamps.boot_of(mark.source) for mark in marks.values() if mark and not mark.is_from_this_boot}
    ahead_ns = clocks.walls_ahead_ns(bus.call, elsewhere, bus.clock)
    for key, mark in marks.items():
        written_ns = mark.wall_ns - ahead_ns.get(stamps.boot_of(mark.source), 0) if mark else None
        known, rate = described.get(key), rates.get(key)
        found.append(
            KeyStatus(
                key=key,
                role=known.role if known else "unknown",
                writer=mark.writer if mark else "foreign",
                rate_hz=rate.rate_hz if rate else 0.0,
                age_s=_age(rate, written_ns, bus.clock.wall_ns()),
            )
        )
    in_order = sorted(found, key=lambda item: (_place(item.role), item.key))
    return Status(str(bus.address), read_health(bus), in_order, stop_file.latched(bus))


def read_status_once(bus: Bus, seconds: float = _LOOK_S) -> Status:
    """Count for a moment and return the status."""
    with RateMeter(bus.address) as meter:
        bus.clock.sleep(seconds)
        return read_status(bus, meter)


_KEYS = (
    Column("key"),
    Column("role", 74),
    Column("writer", 98),
    Column("rate", is_number=True),
    Column("age", is_number=True),
)


def render(status: Status, width: int = WIDE, height: int | None = None) -> Group:
    """Return the status as tables.

    Args:
        status: What there is.
        width: Of the screen [characters]; a narrow one shows fewer columns.
        height: Of the screen [lines]; what has no room is counted. None for no end.
    """
    rows = [
        (plain(item.key), item.role, plain(item.writer), _hertz(item.rate_hz), _since(item.age_s))
        for item in status.keys
    ]
    servers = render_servers(status.servers, width)
    stop = [f"[bold red]{plain(str(status.stop))}[/]"] if status.stop is not None else []
    above = Group(f"[bold]{status.address}[/]", *stop, "", servers, "")
    if height is None or len(rows) <= (room := height - _lines(above, width) - 1):
        return Group(above, table_of(_KEYS, rows, width))
    kept = rows[: max(0, room - 1)]
    more = f"[dim]and {len(rows) - len(kept)} more keys: a higher window, or `station status`, has them all[/]"
    return Group(above, table_of(_KEYS, kept, width), more)


def _lines(shown: RenderableType, width: int) -> int:
    console = Console(file=io.StringIO(), width=width)
    return len(console.render_lines(shown, console.options))


def _place(role: str) -> int:
    """Return which roles come first: what an operator looks for is what the robot is told, and what it does."""
    return _ROLES.index(role) if role in _ROLES else len(_ROLES)


def _age(rate: KeyRate | None, written_wall_ns: int | None, now_wall_ns: int) -> float | None:
    if rate is not None and rate.age_s is not None:
        return rate.age_s
    return None if written_wall_ns is None else (now_wall_ns - written_wall_ns) * 1e-9


def _hertz(rate_hz: float) -> str:
    return f"{rate_hz:.1f} Hz" if rate_hz else "·"


def _since(seconds: float | None) -> str:
    if seconds is None:
        return "unknown"
    if seconds < 1.0:
        return f"{seconds * 1e3:.0f} ms"
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
