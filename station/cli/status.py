"""``station status``: servers, states, key rates and ages."""

from __future__ import annotations

import contextlib
import json
import logging
import time
from typing import TYPE_CHECKING

import click

from station.cli.options import address_of, bus_option, json_option
from station.printable import printable

if TYPE_CHECKING:
    from station.bus.address import BusAddress

_REFRESH_S, _LOOK_S = 0.25, 1.0


@click.command("status")
@click.option(
    "--watch",
    "is_live",
    is_flag=True,
    help="Keep looking until interrupted, also before and after a station runs; with --json a line per look.",
)
@bus_option
@json_option
def command(is_live: bool, bus: str | None, as_json: bool) -> None:
    """Show what runs on the bus and how often each key is written."""
    from station.bus.client import Bus
    from station.cli.tables import wide_console
    from station.errors import BusError
    from station.life.stop_file import StopFile
    from station.view import status

    address = address_of(bus)
    if is_live:
        with contextlib.suppress(KeyboardInterrupt):
            _watch(address, as_json=as_json)
        return
    try:
        line = Bus(address, name="status", timeout_s=1.0)
    except BusError as error:
        latched = StopFile(address).read()
        raise BusError(f"{error}" + (f"; {latched}" if latched is not None else "")) from None
    with line:
        found = status.read_status_once(line)
    if as_json:
        click.echo(json.dumps(found.to_plain()))
    else:
        wide_console().print(status.render(found))
        if not found.servers:
            click.echo("no server has spoken on this bus; start a station with `station up g1-sim-motion`", err=True)


def _watch(address: BusAddress, *, as_json: bool) -> None:
    """Show the status again and again; a bus that is not there, or no more, is waited for."""
    from rich.console import Console
    from rich.live import Live

    from station.bus.client import Bus
    from station.errors import BusError
    from station.life.stop_file import StopFile
    from station.view import status
    from station.view.rates import RateMeter

    logging.getLogger("station.bus").setLevel(logging.ERROR)  # what is said of a lost line is shown below
    console = Console(highlight=False)
    live = None if as_json or not console.is_terminal else Live(console=console, auto_refresh=False, screen=True)

    def show(found: status.Status) -> None:
        if live is not None:
            live.update(status.render(found, *console.size), refresh=True)
        elif as_json:
            click.echo(json.dumps(found.to_plain()))
        else:
            console.print(status.render(found), "", soft_wrap=True)

    with live or contextlib.nullcontext():
        told = ""
        while True:
            try:
                with Bus(address, name="status", timeout_s=1.0) as line, RateMeter(address) as meter:
                    told = ""
                    while True:
                        time.sleep(_LOOK_S if live is None else _REFRESH_S)
                        show(status.read_status(line, meter))
            except BusError as error:
                waiting = printable("; ".join(map(str, filter(None, (error, StopFile(address).read())))))
                if live is not None:
                    live.update(f"{waiting}\nwaiting for it; Ctrl-C ends", refresh=True)
                elif waiting != told:
                    click.echo(f"{waiting}; waiting for it", err=True)
                told = waiting
                time.sleep(_LOOK_S)
