"""``station disarm``: send nothing to the robot any more."""

from __future__ import annotations

import click

from station.api.live import Station
from station.cli.options import bus_option
from station.life import arm_request


@click.command("disarm")
@click.argument("server", default="")
@click.option("--reason", default="", help="Why, for the recording.")
@bus_option
def command(server: str, reason: str, bus: str | None) -> None:
    """Disarm the robot of SERVER, or every robot on the bus: its policy runs on, nothing is sent.

    A robot that is held by its joints alone sinks down: `station estop` damps it instead.
    """
    with Station(bus, name="disarm") as station:
        for name, states in station.disarm(server, reason=reason).items():
            click.echo(f"{name}: {arm_request.story('disarm', states)}")
