"""``station status``: servers, states, key rates and ages."""

from __future__ import annotations

import json
import time

import click

from station.cli.options import address_of, bus_option, json_option


@click.command("status")
@click.option("--watch", "is_live", is_flag=True, help="Keep looking until interrupted.")
@bus_option
@json_option
def command(is_live: bool, bus: str | None, as_json: bool) -> None:
    """Show what runs on the bus and how often each key is written."""
    from rich.console import Console

    from station.bus.client import Bus
    from station.view import status

    with Bus(address_of(bus), name="status", timeout_s=1.0) as line:
        if is_live:
            _follow(line)
            return
        found = status.look_once(line)
    if as_json:
        click.echo(json.dumps(found.to_plain()))
    else:
        Console(highlight=False).print(status.render(found))


def _follow(line: object) -> None:
    from rich.console import Console
    from rich.live import Live

    from station.bus.client import Bus
    from station.view import status
    from station.view.rates import RateMeter

    assert isinstance(line, Bus)
    console = Console(highlight=False)
    with (
        RateMeter(line.address) as meter,
        Live(console=console, auto_refresh=False, screen=console.is_terminal) as live,
    ):
        try:
            while True:
                time.sleep(0.25)
                live.update(status.render(status.look(line, meter)), refresh=True)
        except KeyboardInterrupt:
            return
