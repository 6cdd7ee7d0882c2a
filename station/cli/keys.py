"""``station keys``: what each key of the bus holds."""

from __future__ import annotations

import json

import click
import msgspec

from station.cli import candidates, describe
from station.cli.options import bus_option, json_option
from station.printable import printable


@click.command("keys")
@click.argument("key", default="", shell_complete=candidates.described)
@bus_option
@json_option
def command(key: str, bus: str | None, as_json: bool) -> None:
    """List the keys that have a contract, or describe KEY; a key without one is recorded all the same."""
    if key:
        describe.show(key, bus, as_json=as_json)
        return
    with describe.connected(bus) as (_, known):
        every = known.all()
    if as_json:
        click.echo(json.dumps([msgspec.to_builtins(item) for item in every]))
        return
    for item in every:
        length = str(len(item.elements)) if item.elements else ""
        row = f"{item.key:44} {item.family:8} {item.role:8} {item.codec:12} {length:>4}  {item.note}"
        click.echo(printable(row))
