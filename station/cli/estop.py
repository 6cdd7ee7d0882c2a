"""``station estop``: the latched emergency stop."""

from __future__ import annotations

import getpass

import click

from station.api.live import Station
from station.cli.options import address_of, bus_option
from station.errors import BusError, StationError, UsageError
from station.life.stop_button import keep_for_the_next_start, say_past_bus
from station.life.stop_file import StopFile, remedy


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
    """Stop every robot on the bus: its joints are damped until --reset. `SET station:estop 1` does the same.

    Where the bus is dead or frozen, what `station up` drives on this machine is stopped past it, with exit code 1: see
    that every robot is damped. The stop outlives the bus, its servers and a reboot. After --reset a robot stands;
    commands that ran on through the stop are not followed until they have ceased and begun anew.
    """
    if arm and not reset:
        raise UsageError("--arm: expected together with --reset; a stop arms nothing")
    try:
        address = address_of(bus)
    except StationError as error:  # an address or the user's file of defaults that cannot be read
        if reset:
            raise
        raise UsageError(f"NO robot was stopped ({error}); --bus URL names the bus") from None
    call = None if reset else say_past_bus(address, reason)
    try:
        station = Station(bus, name="estop")
    except BusError as error:
        if call is not None:
            raise keep_for_the_next_start(address, reason, error, call) from None
        _release_without_a_bus(StopFile(address), reason, error)
        return
    if call is not None:
        call.close()  # `Station.estop` says it again, and tells what came of it
    with station:
        if reset:
            station.release(reason, arm=arm)
            click.echo("e-stop released")
            return
        stopped = station.estop(reason)
    said = "every robot on this bus is damped" if stopped else "latched, but no robot runs on this bus"
    click.echo(f"e-stop: {said}; `{remedy(address)}` releases")


def _release_without_a_bus(file: StopFile, reason: str, error: BusError) -> None:
    """Release where no bus answers what is kept for the next start.

    Raises:
        BusError: nothing is kept either.
    """
    if file.read() is None:
        raise error
    file.release(f"{getpass.getuser()}, {reason}")
    click.echo("e-stop released; no bus runs")
