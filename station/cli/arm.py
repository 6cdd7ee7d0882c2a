"""``station arm``: let targets go to the robot, which grows stiff over two seconds."""

from __future__ import annotations

import click

from station.api.live import Station
from station.cli.options import bus_option
from station.life import arm_request


@click.command("arm")
@click.argument("server", default="")
@click.option("--reason", default="", help="Why, for the recording.")
@bus_option
def command(server: str, reason: str, bus: str | None) -> None:
    """Arm the robot of SERVER, or every robot on the bus, and wait until it is.

    Refused while commands come that are stale or not valid, after a fall, and while the emergency stop is latched.
    Where no command comes at all the robot is armed: its policy stands.
    """
    with Station(bus, name="arm") as station:
        for name, states in station.arm(server, reason=reason).items():
            click.echo(f"{name}: {arm_request.story('arm', states)}")
