"""A configuration type as options of the command line, one per field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

import click
import msgspec
from msgspec import inspect

from station.config import choices


@dataclass(frozen=True, slots=True)
class FieldOptions:
    """The options of a type: for click, and from what click gives back to values of the fields."""

    params: list[click.Parameter]
    lists: frozenset[str]

    def values(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields that the user gave; those that were left out keep the type's own defaults."""
        found = {name: value for name, value in given.items() if value is not None}
        for name in self.lists & set(found):
            found[name] = tuple(part.strip() for part in found[name].split(",") if part.strip())
        return found


def options_of(kind: type[msgspec.Struct]) -> FieldOptions:
    """Return the options of a type: the field's name with dashes, its ``Meta(description=…)`` as help.

    A `Literal` is a choice, a ``tuple[str, ...]`` names with commas between them, a bool a flag with its opposite.

    Raises:
        TypeError: a field of a type that has no form on a command line.
    """
    type_info, hints = inspect.type_info(kind), get_type_hints(kind)
    assert isinstance(type_info, inspect.StructType)
    params: list[click.Parameter] = []
    lists: set[str] = set()
    for field in type_info.fields:
        wanted, about = described(field.type)
        flag = f"--{field.name.replace('_', '-')}"
        shape: dict[str, Any] = {}
        if isinstance(wanted, inspect.LiteralType):
            shape = {"type": click.Choice([str(value) for value in choices(hints[field.name])])}
        elif isinstance(wanted, inspect.BoolType):
            shape, flag = {"is_flag": True}, f"{flag}/--no-{flag[2:]}"
        elif isinstance(wanted, inspect.VarTupleType):
            lists.add(field.name)
            shape = {"metavar": "NAME[,NAME]"}
        else:
            shape = {"type": _plain_type(wanted, field.name), "metavar": _METAVARS.get(type(wanted), "TEXT")}
        params.append(click.Option([flag, field.name], default=None, help=_help(about, field), **shape))
    return FieldOptions(params, frozenset(lists))


_METAVARS: dict[type, str] = {inspect.IntType: "N", inspect.FloatType: "X"}


def described(wanted: inspect.Type) -> tuple[inspect.Type, str]:
    """Return a type without what describes it and without None, and its description."""
    about = ""
    while True:
        if isinstance(wanted, inspect.Metadata):
            about = about or str((wanted.extra_json_schema or {}).get("description", ""))
            wanted = wanted.type
        elif isinstance(wanted, inspect.UnionType):
            wanted = next(each for each in wanted.types if not isinstance(each, inspect.NoneType))
        else:
            return wanted, about


def _plain_type(wanted: inspect.Type, name: str) -> Any:
    if isinstance(wanted, inspect.IntType):
        return int
    if isinstance(wanted, inspect.FloatType):
        return float
    if isinstance(wanted, inspect.StrType):
        return str
    raise TypeError(f"option {name}: {type(wanted).__name__} has no form on a command line")


def _help(about: str, field: inspect.Field) -> str:
    default = field.default
    if default in (None, "", (), msgspec.NODEFAULT):
        return about
    shown = ",".join(default) if isinstance(default, tuple) else default
    return f"{about}  [default: {shown}]"
