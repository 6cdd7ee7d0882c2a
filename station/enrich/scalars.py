"""JSON objects as protobuf messages: every scalar that is of one type whenever it is there becomes a field."""

from __future__ import annotations

from typing import Any, Literal

from station.enrich.vector import is_field_name
from station.protobuf.schema import Field, Schema, message_class, schema

Kind = Literal["double", "int64", "bool", "string"]

_MOST_FIELDS = 256  # a writer that invents names must fill neither the memory nor a schema
_DEEPEST = 3
_INT64 = 1 << 63


class Shape:
    """Which scalars the objects of a key hold, learned from all of them; one in an inner object is ``outer_inner``.

    What is a number in one object and text in another has no type, and a name that no field can have is none; both are
    left out. Whole numbers and others make a double together; null says nothing.
    """

    def __init__(self) -> None:
        self._seen: dict[str, set[Kind | None]] = {}

    def learn(self, value: object) -> None:
        """Record one decoded value."""
        if not isinstance(value, dict):
            return
        for name, item in _scalars(value):
            if name not in self._seen:
                if len(self._seen) == _MOST_FIELDS or not is_field_name(name):
                    continue
                self._seen[name] = set()
            if item is not None:
                self._seen[name].add(_kind(item))

    @property
    def fields(self) -> dict[str, Kind]:
        """Names and types of the fields, in order of first appearance."""
        found = {name: _common(kinds) for name, kinds in self._seen.items()}
        return {name: kind for name, kind in found.items() if kind is not None}


class ObjectType:
    """A message type with an optional field per scalar of a `Shape`.

    Attributes:
        schema: Of the message type.
    """

    def __init__(self, name: str, shape: Shape, note: str = "") -> None:
        """Make the type.

        Raises:
            ValueError: the library refuses a name.
        """
        self._kinds = shape.fields
        numbered = enumerate(self._kinds.items(), 1)
        fields = [Field(field, number, kind, is_optional=True) for number, (field, kind) in numbered]
        self.schema: Schema = schema(name, fields, note)
        self._class = message_class(self.schema)

    def encode(self, value: object) -> bytes | None:
        """Return the message of a decoded value; None when it is no object."""
        if not isinstance(value, dict):
            return None
        message = self._class()
        for name, item in _scalars(value):
            if name in self._kinds and item is not None:
                setattr(message, name, float(item) if self._kinds[name] == "double" else item)
        return bytes(message.SerializeToString())


def _scalars(value: dict[str, Any], prefix: str = "", depth: int = 1) -> list[tuple[str, Any]]:
    """Return names and values of the scalars of an object, those of inner ones among them."""
    found: list[tuple[str, Any]] = []
    for name, item in value.items():
        if isinstance(item, dict):
            if depth < _DEEPEST:
                found += _scalars(item, f"{prefix}{name}_", depth + 1)
        elif not isinstance(item, list):
            found.append((prefix + name, item))
    return found


def _kind(value: object) -> Kind | None:
    """Return the type of a scalar; None for a number that no field holds."""
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, int):
        return "int64" if -_INT64 <= value < _INT64 else None
    return "double" if isinstance(value, float) else "string"


def _common(kinds: set[Kind | None]) -> Kind | None:
    """Return the type that holds all of some, or None."""
    if kinds == {"int64", "double"}:
        return "double"
    return next(iter(kinds)) if len(kinds) == 1 else None
