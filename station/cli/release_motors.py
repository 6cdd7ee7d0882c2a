"""``station release-motors``: a robot's own controller lets go of its motors."""

from __future__ import annotations

import click

from station.api.live import Station
from station.cli.options import bus_option


@click.command("release-motors")
@click.argument("robot", default="")
@bus_option
def command(robot: str, bus: str | None) -> None:
    """Have the own controller of ROBOT let go of its motors, so that the robot may be armed.

    The robot goes limp at once: it has to hang, or lie. It is refused while the robot is armed.
    """
    with Station(bus, name="release") as station:
        for name in station.release_motors(robot):
            click.echo(f"{name}: its own controller has let go of the motors")
