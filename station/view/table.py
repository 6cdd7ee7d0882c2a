"""Servers and their states, for people."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from station.life.server import Health
from station.printable import printable

WIDE = 1000
"""A screen with room for everything [characters]."""

_COLOURS = {"active": "green", "inactive": "yellow", "unconfigured": "yellow", "finalized": "dim", "dead": "red"}
_WORDS = {"why_not": "not driving:"}
_HELP = "help"  # which controls move what; `station up` shows it in its row `controls`
_EMPTY: tuple[object, ...] = ("", None, 0, {}, [])


def plain(text: str) -> str:
    """Return a word of the bus as a cell that shows it, colours nothing and steers no terminal."""
    return escape(printable(text))


def state_of(health: Health) -> str:
    """Return the state to show: ``dead`` when a server fell silent without a farewell."""
    return health.state if health.is_alive or health.state == "finalized" else "dead"


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        title: Its heading.
        least: Narrowest screen that it is shown on [characters].
        is_number: Whether it stands to the right.
    """

    title: str
    least: int = 0
    is_number: bool = False


def table_of(columns: Sequence[Column], rows: Iterable[Sequence[str]], width: int) -> Table:
    """Return a table without the columns that a screen of this width [characters] has no room for."""
    shown = [index for index, column in enumerate(columns) if column.least <= width]
    table = Table(box=None, pad_edge=False, header_style="bold")
    for index in shown:
        table.add_column(columns[index].title, justify="right" if columns[index].is_number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(row[index] for index in shown))
    return table


_SERVERS = (Column("server"), Column("state"), Column("pid", 66), Column("rate"), Column("jitter p50 / p99", 84),
            Column("overruns"), Column("lost writes"))  # fmt: skip


def render_servers(servers: Iterable[Health], width: int = WIDE) -> Group:
    """Return a table with a row per server, and below it what each says of its own."""
    rows = []
    words = []
    for health in servers:
        state = state_of(health)
        rows.append((
            plain(health.name),
            f"[{_COLOURS.get(state, 'red')}]{state}[/]",
            str(health.pid),
            _rate(health),
            _jitter(health),
            str(health.overruns) if health.rate_hz is not None else "",
            str(health.lost_writes) if health.lost_writes else "",
        ))  # fmt: skip
        if said := _detail(health):
            words.append(f"[dim]{plain(health.name)}: {said}[/]")
    return Group(table_of(_SERVERS, rows, width), *words)


def age_s(health: Health) -> float:
    """Return the time since a server's last word [s], by the wall clock."""
    return (time.time_ns() - health.wall_ns) * 1e-9


def _detail(health: Health) -> str:
    if health.state == "finalized":
        return plain(health.reason)
    shown = [f"{_WORDS.get(key) or key.replace('_', ' ')} {_value(value)}"
             for key, value in health.detail.items() if value not in _EMPTY and key != _HELP]  # fmt: skip
    return plain(" · ".join(shown))


def _rate(health: Health) -> str:
    if health.rate_hz is None:
        return ""
    if health.why_late:
        return f"[yellow]{health.rate_hz:.1f} of {health.nominal_hz:.0f} Hz[/]"
    return f"{health.rate_hz:.1f} Hz"


def _jitter(health: Health) -> str:
    if health.jitter_p50_ms is None or health.jitter_p99_ms is None:
        return ""
    return f"{health.jitter_p50_ms:.2f} / {health.jitter_p99_ms:.2f} ms"


def _value(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
