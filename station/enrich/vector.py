"""A vector whose elements have names as a protobuf message with one double per element."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

from station.contract import Element
from station.protobuf.schema import MOST_FIELDS, Field, Schema, schema
from station.protobuf.wire import varint

_FIXED64 = 1  # wire type of a double
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class VectorType:
    """A message type with a double per element, named as the contract names it, in its order.

    Every field is written, zeros too: a reader never has to tell a zero from what is missing. The library's own
    encoder takes twenty times as long for the same bytes.

    Attributes:
        schema: Of the message type; each field carries its unit as a comment.
    """

    def __init__(self, name: str, elements: Sequence[Element], note: str = "") -> None:
        """Make the type.

        Raises:
            ValueError: an element's name is no name of a field, or stands twice; or there are too many.
        """
        if len(elements) > MOST_FIELDS:
            raise ValueError(f"{len(elements)} elements, at most {MOST_FIELDS} can be fields")
        for element in elements:
            if not is_field_name(element.name):
                raise ValueError(f"its element {element.name!r} has a name that no field can have")
        fields = [Field(element.name, number, "double", element.unit) for number, element in enumerate(elements, 1)]
        self.schema: Schema = schema(name, fields, note)
        tags = [varint(field.number << 3 | _FIXED64) for field in fields]
        self._pack = struct.Struct("<" + "".join(f"{len(tag)}sd" for tag in tags)).pack
        self._parts: list[bytes | float] = [part for tag in tags for part in (tag, 0.0)]

    def encode(self, values: Sequence[float]) -> bytes:
        """Return the message of a vector of the contract's length."""
        self._parts[1::2] = values
        return self._pack(*self._parts)


def is_field_name(name: str) -> bool:
    """Whether a field can be called so."""
    return _NAME.fullmatch(name) is not None


def type_name(key: str) -> str:
    """Return the full name of the message type of a key: ``robot_state_g1`` is ``station.RobotStateG1``."""
    words = "".join(word[0].upper() + word[1:] for word in re.findall(r"[A-Za-z0-9]+", key))
    return f"station.{words}" if words[:1].isalpha() else f"station.Key{words}"


class TypeNames:
    """Names of message types, each given once."""

    def __init__(self) -> None:
        self._given: set[str] = set()

    def new(self, key: str) -> str:
        """Return a name for the message type of a key that no other key has, as `type_name` or with a number."""
        name = first = type_name(key)
        number = 1
        while name in self._given:
            number += 1
            name = f"{first}_{number}"
        self._given.add(name)
        return name
