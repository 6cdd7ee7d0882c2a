"""``station keys``: what each key of the bus holds."""

from __future__ import annotations

import json

import click
import msgspec

from station.bus import contracts
from station.cli.options import json_option
from station.errors import UsageError, did_you_mean


def _known(_context: click.Context, _parameter: click.Parameter, begun: str) -> list[str]:
    """Return what a shell may complete."""
    return [item.key for item in contracts.contracts() if item.key.startswith(begun)]


@click.command("keys")
@click.argument("key", default="", shell_complete=_known)
@json_option
def command(key: str, as_json: bool) -> None:
    """List the keys that have a contract, or show the one of KEY element by element."""
    if not key:
        _list(as_json)
        return
    found = contracts.contract(key)
    if found is None:
        known = [item.key for item in contracts.contracts()]
        raise UsageError(
            f"key {key!r} has no contract{did_you_mean(key, known)}; `station keys` lists the {len(known)} that have "
            "one (a key without is recorded all the same)"
        )
    if as_json:
        click.echo(msgspec.json.encode(found).decode())
        return
    click.echo(f"{found.key}: {found.role}, {found.codec}, {found.family}" + (f" — {found.note}" if found.note else ""))
    for index, element in enumerate(found.elements):
        click.echo(f"{index:4}  {element.name:32} {element.unit}")


def _list(as_json: bool) -> None:
    every = contracts.contracts()
    if as_json:
        click.echo(json.dumps([msgspec.to_builtins(item) for item in every]))
        return
    for item in every:
        length = str(len(item.elements)) if item.elements else ""
        click.echo(f"{item.key:44} {item.family:8} {item.role:8} {item.codec:12} {length:>4}  {item.note}")
