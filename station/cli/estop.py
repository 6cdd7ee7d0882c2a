"""``station estop``: the latched emergency stop."""

from __future__ import annotations

import getpass

import click

from station.bus import codec, keys
from station.bus.client import Bus
from station.cli.options import address_of, bus_option
from station.errors import BusError, UsageError


@click.command("estop")
@click.option(
    "--reset",
    is_flag=True,
    help="Release the latch: a simulated robot is put back on its feet, a real one is disarmed.",
)
@click.option("--arm", is_flag=True, help="With --reset: arm the robot too, which a real one needs to move again.")
@click.option("--reason", default="asked for on the command line", show_default=True, help="Why, for the recording.")
@bus_option
def command(reset: bool, arm: bool, reason: str, bus: str | None) -> None:
    """Stop every robot on the bus: its joints are damped until --reset. `SET station:estop 1` does the same."""
    if arm and not reset:
        raise UsageError("--arm: expected together with --reset; a stop arms nothing")
    with Bus(address_of(bus), name="estop", timeout_s=1.0) as line:
        request = {"stop": not reset, "who": getpass.getuser(), "reason": reason} | ({"arm": True} if arm else {})
        if not line.publish({keys.ESTOP: codec.json_object(request)}):
            raise BusError(f"bus {line.address}: the stop was NOT taken ({line.last_error}); use the robot's own stop")
    click.echo(
        "e-stop released" if reset else "e-stop: every robot on this bus is damped; `station estop --reset` releases"
    )
