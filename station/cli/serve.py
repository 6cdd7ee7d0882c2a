"""``station serve``: run one server in this terminal."""

from __future__ import annotations

import json

import click

from station import config, registry
from station.cli.options import bus_option, set_option
from station.errors import ConfigError


@click.command("serve")
@click.argument("server")
@bus_option
@set_option("key=value")
@click.option("--name", default="", help="Name on the bus, when two of a kind run.  [default: the server's]")
@click.option("--config-json", hidden=True, default="", help="Whole configuration, from a supervisor.")
@click.option("--list-keys", is_flag=True, help="Print the keys that --set takes, with their defaults, and exit.")
def command(server: str, bus: str | None, sets: tuple[str, ...], name: str, config_json: str, list_keys: bool) -> None:
    """Run SERVER until it is interrupted."""
    from station.cli.options import address_of
    from station.life.server import ServerKind, serve

    kind: ServerKind = registry.find("server", server)
    if list_keys:
        _print_keys(kind)
        return
    base = json.loads(config_json) if config_json else {}
    if not isinstance(base, dict):
        raise ConfigError("--config-json: expected an object")
    values = config.merged(base, config.overrides(sets, servers=None).get("", {}))
    code = serve(kind, config.build(kind.config, values, where=f"server {server}"), address=address_of(bus), name=name)
    raise SystemExit(code)


def _print_keys(kind: object) -> None:
    import msgspec

    for field in msgspec.structs.fields(kind.config):  # type: ignore[attr-defined]
        default = "required" if field.required else repr(_default(field))
        click.echo(f"{field.encode_name} = {default}")


def _default(field: object) -> object:
    import msgspec

    factory = field.default_factory  # type: ignore[attr-defined]
    if factory is not msgspec.NODEFAULT:
        return factory()
    return field.default  # type: ignore[attr-defined]
