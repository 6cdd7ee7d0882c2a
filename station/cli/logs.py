"""``station logs``: what the servers of a station printed."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click
import msgspec

from station.cli import candidates, log_lines
from station.cli.options import address_of, bus_option, json_option
from station.errors import StationError, UnknownName
from station.printable import printable

_LOOK_S = 0.2
_MOST_BYTES = 4 * 1024 * 1024


@click.command("logs")
@click.argument("servers", metavar="[SERVER]...", nargs=-1, shell_complete=candidates.logs)
@click.option("-n", "--lines", "count", type=click.IntRange(0), default=20, show_default=True,
              help="Of each server, the last ones.")  # fmt: skip
@click.option("-f", "--follow", "is_live", is_flag=True, help="Go on with what comes, until interrupted.")
@json_option
@bus_option
def command(servers: Sequence[str], count: int, is_live: bool, as_json: bool, bus: str | None) -> None:
    """Print the last lines that servers of `station up` printed on this machine, of SERVER or of all.

    They are kept until the server is started again. With STATION_LOG_FORMAT=json in the environment of `station up` its
    servers log objects with time, level, logger, pid and message; --json prints these with the name of their server,
    and each other line as an object of server and message. STATION_LOG names a level: debug, info, warning, error,
    critical.
    """
    from station.supervision.supervisor import log_folder

    folder = log_folder(address_of(bus))
    files = {file.stem: file for file in sorted(folder.glob("*.log"))}
    for name in servers:
        if name not in files:
            raise UnknownName("server's log", name, files)
    if not files:
        raise StationError(f"no logs in {folder}: no `station up` has run on that bus; name another with --bus")
    chosen = {name: files[name] for name in servers} or files
    show = _print_objects if as_json else partial(_print, width=max(map(len, chosen)))
    tails = {name: _Tail(file) for name, file in chosen.items()}
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


class _Tail:
    """Reads a log as it grows; one that was begun anew is read from its beginning."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inode, self._offset = 0, 0

    def read(self, *, is_last: bool = False) -> list[str]:
        """Return the lines that are new, a line that is not whole yet only where it is the last look."""
        try:
            with self._path.open("rb") as file:
                state = os.fstat(file.fileno())
                if state.st_ino != self._inode or state.st_size < self._offset:
                    self._inode, self._offset = state.st_ino, max(0, state.st_size - _MOST_BYTES)
                file.seek(self._offset)
                text = file.read(_MOST_BYTES)
        except FileNotFoundError:  # between one station and the next
            return []
        end = len(text) if is_last or len(text) == _MOST_BYTES else text.rfind(b"\n") + 1
        self._offset += end
        return text[:end].decode("utf-8", "replace").splitlines()
