"""``station robot-twin``: run a robot twin, or switch faults of one that runs."""

from __future__ import annotations

import json

import click

from station import config, registry
from station.cli import candidates
from station.cli.options import bus_option, set_option
from station.errors import UsageError


@click.command("robot-twin")
@click.argument("twin", shell_complete=candidates.registered("twin"))
@click.argument("changes", nargs=-1, metavar="[FAULT=VALUE]...")
@click.option("--well", "is_well", is_flag=True, help="Switch off all other faults of the twin that runs.")
@click.option("--faults", "is_listing", is_flag=True, help="List what can be wrong with it, and exit.")
@bus_option
@set_option("key=value")
def command(
    twin: str, changes: tuple[str, ...], is_well: bool, is_listing: bool, bus: str | None, sets: tuple[str, ...]
) -> None:
    """Run TWIN, which stands at the other end of a real robot's cable, until it is interrupted.

    With FAULT=VALUE it switches faults of the one that runs, and prints how that is:

    \b
      station robot-twin g1 gantry=slack
      station robot-twin g1 winding_c.left_knee=121 remote='[L2, B]'
      station robot-twin g1 --well
    """
    from station.cli.options import address_of
    from station.robot_twin import TwinKind

    kind: TwinKind = registry.find("twin", twin)
    if is_listing:
        from station.cli.settings import print_settings, settings_of

        print_settings(list(settings_of(kind.faults)))
        return
    if not (changes or is_well):
        from station.cli.serve import command as serve

        serve.callback(  # type: ignore[misc]  # a command has one
            server="robot-twin",
            bus=bus,
            sets=(f"twin={twin}", *sets),
            name="",
            config_json="",
            is_expected=False,
            list_keys=False,
        )
        return
    if sets:
        raise UsageError("--set is for a twin that is started; faults of one that runs are FAULT=VALUE")
    from station.bus.client import Bus
    from station.life import twin_request

    faults = config.overrides(changes, servers=None).get("", {})
    with Bus(address_of(bus), name="robot-twin") as connection:
        said = twin_request.ask(connection, twin, faults, is_well=is_well)
    for name, value in said.items():
        if name != "changed":
            click.echo(f"{name}: {value if isinstance(value, str) else json.dumps(value)}")
