"""Servers and their states, for people."""

from __future__ import annotations

import time
from collections.abc import Iterable

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from station.life.server import Health
from station.printable import printable

_COLOURS = {"active": "green", "inactive": "yellow", "unconfigured": "yellow", "finalized": "dim", "dead": "red"}
_EMPTY: tuple[object, ...] = ("", None, 0, {}, [])


def plain(text: str) -> str:
    """Return a word of the bus as a cell that shows it, colours nothing and steers no terminal."""
    return escape(printable(text))


def state_of(health: Health) -> str:
    """Return the state to show: ``dead`` when a server fell silent without a farewell."""
    return health.state if health.is_alive or health.state == "finalized" else "dead"


def render_servers(servers: Iterable[Health]) -> Group:
    """Return a table with a row per server, and below it what each says of its own."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("server", "state", "pid", "rate", "jitter p50 / p99", "overruns", "lost writes"):
        table.add_column(title, no_wrap=True)
    words = []
    for health in servers:
        state = state_of(health)
        table.add_row(
            plain(health.name),
            f"[{_COLOURS.get(state, 'red')}]{state}[/]",
            str(health.pid),
            "" if health.rate_hz is None else f"{health.rate_hz:.1f} Hz",
            _jitter(health),
            str(health.overruns) if health.rate_hz is not None else "",
            str(health.lost_writes) if health.lost_writes else "",
        )
        if said := _detail(health):
            words.append(f"[dim]{plain(health.name)}: {said}[/]")
    return Group(table, *words)


def age_s(health: Health) -> float:
    """Return the time since a server's last word [s], by the wall clock."""
    return (time.time_ns() - health.wall_ns) * 1e-9


def _detail(health: Health) -> str:
    if health.state == "finalized":
        return plain(health.reason)
    shown = [f"{key.replace('_', ' ')} {_value(value)}" for key, value in health.detail.items() if value not in _EMPTY]
    return plain(" · ".join(shown))


def _jitter(health: Health) -> str:
    if health.jitter_p50_ms is None or health.jitter_p99_ms is None:
        return ""
    return f"{health.jitter_p50_ms:.2f} / {health.jitter_p99_ms:.2f} ms"


def _value(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
