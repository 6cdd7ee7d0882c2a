"""``station policy``: which policy drives a robot, and have another one take over while it moves."""

from __future__ import annotations

import click

from station.api.live import Station
from station.cli.options import Verbs, bus_option

_robot_option = click.option(
    "--robot", default="", help="Name of the robot, or of its server; needed where several run."
)


@click.group("policy", cls=Verbs)
def command() -> None:
    """See which policy drives a robot, and have another one take over while it moves."""


@command.command("list")
@_robot_option
@bus_option
def listed(robot: str, bus: str | None) -> None:
    """List the policies of each robot that a policy drives; the one that drives is marked."""
    with Station(bus, name="policy") as station:
        for each in station.policies(robot):
            names = (f"{name} (drives)" if name == each.driving else name for name in each.names)
            click.echo(f"{each.robot}: {', '.join(names)}")


@command.command("switch")
@click.argument("policy")
@_robot_option
@bus_option
def switch(policy: str, robot: str, bus: str | None) -> None:
    """Have POLICY drive the robot, and wait until it does.

    POLICY is named in the settings of the robot's server, under `policies`. It observes beside the one that drives for
    a fifth of a second; then the targets of both are blended over half a second (setting `blend_s`). The robot may
    move meanwhile, and its commands go on.
    """
    with Station(bus, name="policy") as station:
        click.echo(f"{station.switch_policy(policy, robot)}: {policy} drives")
