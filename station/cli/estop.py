"""``station estop``: the latched emergency stop."""

from __future__ import annotations

import click

from station.cli.options import address_of, bus_option
from station.errors import NotReady, UsageError
from station.life.stop_button import StopButton


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
    with StopButton(address_of(bus)) as button:
        if reset:
            button.release(reason, arm=arm)
            click.echo("e-stop released")
            return
        button.press(reason)
        robots = button.robots()
        if left := button.unstopped():
            said = ", ".join(f"{name} ({state})" for name, state in left.items())
            raise NotReady(f"the bus has the stop, but not every robot obeys: {said}; use the robot's own stop")
    said = "every robot on this bus is damped" if robots else "latched, but no robot runs on this bus"
    click.echo(f"e-stop: {said}; `station estop --reset` releases")
