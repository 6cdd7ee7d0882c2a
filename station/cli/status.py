"""``station status``: servers, states, key rates and ages."""

from __future__ import annotations

import contextlib
import json
import time
from typing import TYPE_CHECKING

import click

from station.cli.options import address_of, bus_option, json_option

if TYPE_CHECKING:
    from station.bus.client import Bus


@click.command("status")
@click.option("--watch", "is_live", is_flag=True, help="Keep looking until interrupted; with --json a line per look.")
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
    try:
        line = Bus(address, name="status", timeout_s=1.0)
    except BusError as error:
        latched = StopFile(address).read()
        raise BusError(f"{error}" + (f"; {latched}" if latched is not None else "")) from None
    with line:
        if is_live:
            with contextlib.suppress(KeyboardInterrupt):
                _follow(line, as_json=as_json)
            return
        found = status.read_status_once(line)
    if as_json:
        click.echo(json.dumps(found.to_plain()))
    else:
        wide_console().print(status.render(found))
        if not found.servers:
            click.echo("no server has spoken on this bus; start a station with `station up g1-sim-motion`", err=True)


def _follow(line: Bus, *, as_json: bool) -> None:
    """Show the status again and again; a bus that goes away ends it."""
    from rich.console import Console
    from rich.live import Live

    from station.view import status
    from station.view.rates import RateMeter

    console = Console(highlight=False)
    with RateMeter(line.address) as meter:
        if as_json or not console.is_terminal:
            while True:
                time.sleep(1.0)
                found = status.read_status(line, meter)
                if as_json:
                    click.echo(json.dumps(found.to_plain()))
                else:
                    console.print(status.render(found), "", soft_wrap=True)
        with Live(console=console, auto_refresh=False, screen=True) as live:
            while True:
                time.sleep(0.25)
                live.update(status.render(status.read_status(line, meter), console.width), refresh=True)
