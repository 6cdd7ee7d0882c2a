"""``station logs``: what the servers of a station printed."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click
import msgspec

from station.cli import candidates, log_lines
from station.cli.options import address_of, bus_option, json_option
from station.errors import BusError, StationError, UnknownName
from station.printable import printable

if TYPE_CHECKING:
    from station.bus.client import Bus

_LOOK_S = 0.2


@click.command("logs")
@click.argument("servers", metavar="[SERVER]...", nargs=-1, shell_complete=candidates.logs)
@click.option("-n", "--lines", "count", type=click.IntRange(0), default=20, show_default=True,
              help="Of each server, the last ones.")  # fmt: skip
@click.option("-f", "--follow", "is_live", is_flag=True, help="Go on with what comes, until interrupted.")
@json_option
@bus_option
def command(servers: Sequence[str], count: int, is_live: bool, as_json: bool, bus: str | None) -> None:
    """Print the last lines that servers of `station up` printed, of SERVER or of all.

    Of servers on other machines that is what came over the bus: their newest lines. On this machine all are kept until
    the server is started again. With STATION_LOG_FORMAT=json in the environment of `station up` its servers log objects
    with time, level, logger, pid and message; --json prints these with the name of their server, and each other line as
    an object of server and message. STATION_LOG names a level: debug, info, warning, error, critical.
    """
    from station.bus.client import Bus
    from station.supervision.log_tail import LogTail
    from station.supervision.supervisor import log_folder

    address = address_of(bus)
    folder = log_folder(address)
    with contextlib.ExitStack() as stack:
        line = None
        with contextlib.suppress(BusError):  # what is on this machine is shown without it too
            line = stack.enter_context(Bus(address, name="logs", timeout_s=1.0))
        known: dict[str, _Tail] = {file.stem: LogTail(file) for file in sorted(folder.glob("*.log"))}
        if line is not None:
            known |= _of_other_machines(line, folder)
        for name in servers:
            if name not in known:
                raise UnknownName("server's log", name, known)
        if not known:
            raise StationError(f"no logs in {folder}: no `station up` has run on that bus; name another with --bus")
        tails = {name: known[name] for name in servers} or known
        _show(tails, count, is_live=is_live, as_json=as_json)


def _of_other_machines(bus: Bus, folder: Path) -> dict[str, _Tail]:
    """Return the logs of servers that agents have started, but for those whose newer file is here."""
    from station.supervision.agent import HostTail, read_logs

    found: dict[str, _Tail] = {}
    for name, log in read_logs(bus).items():
        file = folder / f"{name}.log"
        if not file.exists() or file.stat().st_mtime_ns < log.wall_ns:
            found[name] = HostTail(bus, name)
    return found


class _Tail(Protocol):
    def read(self, *, is_last: bool = False) -> list[str]: ...


def _show(tails: Mapping[str, _Tail], count: int, *, is_live: bool, as_json: bool) -> None:
    show = _print_objects if as_json else partial(_print, width=max(map(len, tails)))
    for name, tail in tails.items():
        lines = tail.read(is_last=not is_live)
        show(name, lines[len(lines) - min(count, len(lines)) :])
    if is_live:
        with contextlib.suppress(KeyboardInterrupt):
            _follow(tails, show)


def _follow(tails: Mapping[str, _Tail], show: Callable[[str, Sequence[str]], None]) -> None:
    while True:
        for name, tail in tails.items():
            show(name, tail.read())
        time.sleep(_LOOK_S)


def _print(name: str, lines: Sequence[str], width: int) -> None:
    for line in lines:
        click.echo(printable(f"{name:{width}} | {line}", log_lines.LONGEST))


def _print_objects(name: str, lines: Sequence[str]) -> None:
    for line in lines:
        click.echo(_object(name, line))


def _object(name: str, line: str) -> bytes:
    """Return a line as an object that names its server; its values stay as they are written."""
    try:
        found: dict[str, Any] = msgspec.json.decode(line, type=dict[str, msgspec.Raw])
    except (msgspec.DecodeError, RecursionError):
        found = {"message": line}
    return msgspec.json.encode(found | {"server": name})
