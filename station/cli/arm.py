"""``station arm``: let targets go to the robot, which grows stiff over two seconds."""

from __future__ import annotations

import click

from station.bus.client import Bus
from station.cli.options import address_of, bus_option
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
    with Bus(address_of(bus), name="arm", timeout_s=1.0) as line:
        for name, states in arm_request.ask(line, "arm", server=server, reason=reason).items():
            click.echo(f"{name}: {arm_request.story('arm', states)}")
