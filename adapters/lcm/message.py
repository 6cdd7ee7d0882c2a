"""LCM's messages: a type is a table of fields, its fingerprint tells it from others, values are big-endian.

A message is the 8 bytes of its type's fingerprint, then its fields in the order of the table. The fingerprint is a hash
of the fields' names, primitive types and lengths. The name of the type is no part of it: two types of equal fields have
one fingerprint, and only the channel tells their messages apart.

Of LCM's types those are here whose fields are numbers, or arrays of a fixed length: no text, no lengths that a message
says itself, no types within types. Facts of the layout: lcm-proj/lcm, its pages on types and `lcmgen/lcmgen.c`.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

Primitive = Literal["int8_t", "int16_t", "int32_t", "int64_t", "float", "double"]
Value = int | float | tuple[int, ...] | tuple[float, ...]

_CODES: dict[Primitive, str] = {
    "int8_t": "b", "int16_t": "h", "int32_t": "i", "int64_t": "q", "float": "f", "double": "d",
}  # fmt: skip
_SEED = 0x12345678
_BITS = (1 << 64) - 1
_FINGERPRINT = struct.Struct(">Q")
_CONSTANT = 0  # a dimension that the type fixes; 1 is one that another field of the message says


class BadMessage(ValueError):
    """Bytes that are no message of the type; `kind` is the reason in a word."""

    def __init__(self, kind: Literal["fingerprint", "length"], text: str) -> None:
        super().__init__(text)
        self.kind = kind


class Field(NamedTuple):
    """A number, or an array of them.

    Attributes:
        primitive: Its type.
        name: Its name.
        length: Of the array; 0 for a single number.
    """

    primitive: Primitive
    name: str
    length: int = 0


@dataclass(frozen=True)
class MessageType:
    """A type.

    Attributes:
        name: Its name, which no message carries.
        fields: In the order of their bytes.
    """

    name: str
    fields: tuple[Field, ...]

    @cached_property
    def fingerprint(self) -> int:
        """What its messages begin with, of 64 bits."""
        value = _SEED
        for field in self.fields:
            dimensions = [field.length] if field.length else []
            value = _hash_text(_hash_text(value, field.name), field.primitive)
            value = _hash(value, len(dimensions))
            for length in dimensions:
                value = _hash_text(_hash(value, _CONSTANT), str(length))
        return ((value << 1) | (value >> 63)) & _BITS

    @cached_property
    def _layout(self) -> struct.Struct:
        return struct.Struct(">" + "".join(f"{field.length or 1}{_CODES[field.primitive]}" for field in self.fields))

    @property
    def size(self) -> int:
        """Length of its messages [bytes]."""
        return _FINGERPRINT.size + self._layout.size

    def encode(self, values: Mapping[str, float | Sequence[float]]) -> bytes:
        """Return a message.

        Args:
            values: By the name of each field, a number or a sequence of as many as its length.

        Raises:
            ValueError: a field lacks, one is unknown, or a value is not of its field's type or length.
        """
        if values.keys() != {field.name for field in self.fields}:
            expected, came = ", ".join(field.name for field in self.fields), ", ".join(values)
            raise ValueError(f"{self.name}: expected the fields {expected}; got {came or 'none'}")
        numbers: list[float] = []
        for field in self.fields:
            value = values[field.name]
            row = list(value) if isinstance(value, Sequence) else [value]
            if len(row) != (field.length or 1) or isinstance(value, Sequence) != bool(field.length):
                raise ValueError(f"{self.name}: {field.name} is of {len(row)} numbers, expected {field.length or 1}")
            numbers += row
        try:
            return _FINGERPRINT.pack(self.fingerprint) + self._layout.pack(*numbers)
        except (struct.error, OverflowError) as error:
            raise ValueError(f"{self.name}: {error}") from None

    def decode(self, data: bytes) -> dict[str, Value]:
        """Return the values of a message by the names of their fields: a number, or as many as the field is long.

        Raises:
            BadMessage: of another length, or of another fingerprint.
        """
        if len(data) != self.size:
            raise BadMessage("length", f"{len(data)} bytes, expected the {self.size} of {self.name}")
        (fingerprint,) = _FINGERPRINT.unpack_from(data)
        if fingerprint != self.fingerprint:
            raise BadMessage(
                "fingerprint", f"fingerprint {fingerprint:016x}, expected {self.fingerprint:016x} of {self.name}"
            )
        numbers = self._layout.unpack_from(data, _FINGERPRINT.size)
        found: dict[str, Value] = {}
        start = 0
        for field in self.fields:
            end = start + (field.length or 1)
            found[field.name] = numbers[start:end] if field.length else numbers[start]
            start = end
        return found


def _hash(value: int, item: int) -> int:
    """Return a hash after one more byte; the shift to the right repeats the sign."""
    signed = value - (1 << 64) if value >> 63 else value
    return ((value << 8) ^ (signed >> 55)) + item & _BITS


def _hash_text(value: int, text: str) -> int:
    value = _hash(value, len(text))
    for byte in text.encode():
        value = _hash(value, byte)
    return value
