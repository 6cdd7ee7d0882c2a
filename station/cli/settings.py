"""``station settings``: what the servers are, and what each of their settings means."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import click
import msgspec

from station import config, registry
from station.cli import candidates
from station.cli.fields import described
from station.cli.options import json_option, set_option
from station.errors import ConfigError, UsageError
from station.life.server import ServerKind
from station.printable import printable

_ENTRY = re.compile(r" {4}(\w+(?:, \w+)*): (.*)")
_TYPES: dict[type, str] = {
    msgspec.inspect.BoolType: "true or false", msgspec.inspect.IntType: "whole number",
    msgspec.inspect.FloatType: "number", msgspec.inspect.StrType: "text", msgspec.inspect.DictType: "mapping",
    msgspec.inspect.VarTupleType: "list", msgspec.inspect.CustomType: "path",
}  # fmt: skip
_INDENT, _NARROWEST, _WIDEST = 6, 40, 100


class Setting(msgspec.Struct, frozen=True):
    """A setting of a server.

    Attributes:
        name: As ``--set`` and a runbook's ``with`` take it; with a dot below a mapping.
        type: What it is, in words.
        required: Whether it must be given.
        default: Its value where none is given.
        choices: The only values that it may have; empty for any of the type.
        about: What it means, its unit in brackets.
    """

    name: str
    type: str
    required: bool
    default: Any
    choices: tuple[str, ...]
    about: str


@click.command("settings")
@click.argument("server", default="", shell_complete=candidates.registered("server"))
@set_option("key=value")
@json_option
def command(server: str, sets: tuple[str, ...], as_json: bool) -> None:
    """List the settings of SERVER: their defaults, and what they mean; without SERVER, list the servers.

    What a driver, a robot or a camera's source takes is listed for the one that is set: `--set driver=body` shows
    another.
    """
    if sets and not server:
        raise UsageError(f"--set {sets[0]}: of which server? `station settings SERVER --set …`")
    if server:
        show(registry.find("server", server), sets, as_json=as_json)
        return
    kinds: list[ServerKind] = [registry.find("server", name) for name in registry.names("server")]
    if as_json:
        click.echo(json.dumps([{"name": kind.name, "role": kind.role, "about": kind.summary} for kind in kinds]))
        return
    from station.cli.tables import Column, plain, print_table

    columns = [Column("server", "left"), Column("role", "left"), Column("what it does", "left")]
    print_table(columns, [(plain(kind.name), kind.role, plain(kind.summary)) for kind in kinds])
    click.echo("\nwhat one of them can be told: station settings SERVER")


def show(kind: ServerKind, sets: Sequence[str] = (), *, as_json: bool = False) -> None:
    """Print the settings of a kind of server.

    Args:
        kind: The server's.
        sets: ``key=value`` options; what they choose decides which options of drivers, robots and sources are shown.
        as_json: Whether for programs.

    Raises:
        ConfigError: `sets` are none of its settings.
    """
    found = list(settings_of(kind.config, _option_types(kind, sets)))
    if as_json:
        click.echo(msgspec.json.encode(found, enc_hook=str))
        return
    print_settings(found)


def print_settings(found: Sequence[Setting]) -> None:
    """Print settings for people: name and default, and what each means."""
    shown = click.get_current_context().make_formatter()
    shown.width = min(max(shown.width, _NARROWEST), _WIDEST)
    for setting in found:
        value = "  (required)" if setting.required else json.dumps(setting.default)
        choice = f" [{' | '.join(setting.choices)}]" if setting.choices else ""
        click.echo(printable(f"{setting.name}={value}"))
        shown.current_indent = _INDENT
        shown.write_text(printable(f"{setting.about}{choice}" or setting.type))
        click.echo(shown.getvalue(), nl=False)
        shown.buffer.clear()


def settings_of(
    kind: type[msgspec.Struct],
    within: Mapping[str, type[msgspec.Struct]] = {},
    prefix: str = "",
    *,
    is_optional: bool = False,
) -> Iterator[Setting]:
    """Yield the settings that a configuration's type has, in its order.

    Args:
        kind: The type; what its fields mean stands under ``Attributes:`` in its docstring, or in that of a base.
        within: Types of settings that are mappings, by name, with a dot below a mapping of mappings.
        prefix: Before each name.
        is_optional: Whether all of them may be left out together: then none must be given.
    """
    about = _about(kind)
    for field in msgspec.structs.fields(kind):
        name = field.encode_name
        wanted, note = described(info := msgspec.inspect.type_info(field.type))
        inner = {key: each for key, each in within.items() if key == name or key.startswith(f"{name}.")}
        if isinstance(wanted, msgspec.inspect.StructType):
            inner = {name: wanted.cls}
        for key, each in inner.items():
            may_lack = is_optional or (not field.required and _default(field) is None)
            yield from settings_of(each, prefix=f"{prefix}{key}.", is_optional=may_lack)
        if inner:
            continue
        yield Setting(
            name=f"{prefix}{name}",
            type=_TYPES.get(type(wanted), "text"),
            required=field.required and not is_optional,
            default=None if field.required else msgspec.to_builtins(_default(field), enc_hook=str),
            choices=_choices(field.type, info),
            about=note or about.get(name, ""),
        )


def _choices(wanted: Any, info: msgspec.inspect.Type) -> tuple[str, ...]:
    """Return the only values that a setting may have; empty for any of its type."""
    if isinstance(info, msgspec.inspect.Metadata) and info.extra and "registered" in info.extra:
        return tuple(registry.names(info.extra["registered"]))
    if isinstance(described(info)[0], msgspec.inspect.LiteralType):
        return tuple(map(str, config.choices(wanted)))
    return ()


def _about(kind: type) -> dict[str, str]:
    """Return what the docstrings of a type and its bases say of each attribute, the type's own words first."""
    found: dict[str, str] = {}
    for each in kind.__mro__:
        _, _, section = inspect.cleandoc(each.__doc__ or "").partition("Attributes:\n")
        names: list[str] = []
        own: dict[str, str] = {}
        for line in section.partition("\n\n")[0].splitlines():
            if entry := _ENTRY.fullmatch(line):
                names = entry[1].split(", ")
                own |= dict.fromkeys(names, entry[2])
            else:
                own |= {name: f"{own[name]} {line.strip()}" for name in names}
        found = own | found
    return {name: _as_yaml(words) for name, words in found.items()}


def _as_yaml(words: str) -> str:
    """Return the words of a docstring with YAML's null in place of Python's None."""
    return re.sub(r"\bNone\b", "null", words.replace("``", "`"))


def _option_types(kind: ServerKind, sets: Sequence[str]) -> Mapping[str, type[msgspec.Struct]]:
    """Return the types of the mappings among the settings, where what is set says which they are."""
    values = config.overrides(sets, servers=None).get("", {})
    try:
        built = config.build(kind.config, values, where=f"server {kind.name}")
    except ConfigError:
        if sets:
            raise
        return {}  # what is required is not known yet
    return getattr(built, "option_types", {})


def _default(field: msgspec.structs.FieldInfo) -> Any:
    return field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()
