"""``station serve``: run one server in this terminal."""

from __future__ import annotations

import json
from typing import Any

import click

from station import config, python_child, registry
from station.cli import candidates, log_lines
from station.cli.options import bus_option, set_option
from station.cli.settings import show
from station.errors import ConfigError


@click.command("serve")
@click.argument("server", shell_complete=candidates.registered("server"))
@bus_option
@set_option("key=value")
@click.option("--name", default="", help="Name on the bus, when two of a kind run.  [default: the server's]")
@click.option("--config-json", hidden=True, default="", help="Whole configuration, from a supervisor.")
@click.option("--expect", "is_expected", is_flag=True, hidden=True,
              help="Look for what that names, which a supervisor on another machine could not.")  # fmt: skip
@click.option("--list-keys", is_flag=True, help="List what --set takes, as `station settings` does, and exit.")
def command(
    server: str, bus: str | None, sets: tuple[str, ...], name: str, config_json: str, is_expected: bool, list_keys: bool
) -> None:
    """Run SERVER until it is interrupted."""
    from station.cli.options import address_of
    from station.life.server import ServerKind
    from station.life.serving import serve

    kind: ServerKind = registry.find("server", server)
    if list_keys:
        show(kind, sets)
        return
    values = config.merged(_base(config_json), config.overrides(sets, servers=None).get("", {}))
    built = config.build(kind.config, values, where=f"server {server} (`station settings {server}` lists them)")
    if kind.expect is not None and (is_expected or not config_json):  # else a supervisor has asked before
        kind.expect(built)
    python_child.write_stacks_when_asked()
    with log_lines.never_waited_for():
        raise SystemExit(serve(kind, built, address=address_of(bus), name=name))


def _base(text: str) -> dict[str, Any]:
    try:
        base = json.loads(text or "{}")
    except ValueError as error:
        raise ConfigError(f"--config-json: not JSON: {error}") from None
    if not isinstance(base, dict):
        raise ConfigError(f"--config-json: expected an object, got {type(base).__name__}")
    return base
