"""GEAR-SONIC's packed message: a topic, 1280 bytes of JSON that list the fields, then their numbers. Pure.

::

    topic      "command", "planner", "pose"; no end of its own, the header begins with "{"
    header     1280 bytes: {"v": 1, "endian": "le", "count": 1, "fields": [{"name", "dtype", "shape"}, …]}, then zeros
    payload    the fields' numbers in that order, with nothing between or behind them

Numbers are ``f32``, ``f64``, ``i32``, ``i64``, ``u8`` or ``bool``. The shape is what a stranger says: nothing is made
of that size before the bytes that there are have been compared with it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

HEADER_BYTES = 1280
MOST_BYTES = 1 << 18
"""Of a message: 100 frames of 29 joints with SMPL beside them take 100 kB."""

Array = NDArray[Any]
Kind = Literal["wrong-length", "wrong-header", "wrong-version", "wrong-fields", "not-finite", "no-meaning"]

_DTYPES = {"f32": "f4", "f64": "f8", "i32": "i4", "i64": "i8", "u8": "u1", "bool": "u1"}
_NAMES = {"f4": "f32", "f8": "f64", "i4": "i32", "i8": "i64", "u1": "u8", "b1": "bool"}
_ORDER = {"le": "<", "be": ">", "": "<"}
_ORDERED = {
    (endian, name): np.dtype(order + kind) for endian, order in _ORDER.items() for name, kind in _DTYPES.items()
}
_MOST_FIELDS, _MOST_DIMENSIONS = 32, 4


class BadMessage(ValueError):
    """Bytes that are no such message, or one that has no meaning here; `kind` is the reason in a word."""

    def __init__(self, kind: Kind, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class _Field(msgspec.Struct, frozen=True):
    name: str
    dtype: str
    shape: list[int]


class _Header(msgspec.Struct, frozen=True):
    v: int
    fields: list[_Field]
    endian: str = ""


_HEADERS = msgspec.json.Decoder(_Header)


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """What a message says.

    Attributes:
        version: Of the topic's protocol.
        fields: Numbers by the name of their field, each in its shape; ``bool`` as 0 and others.
    """

    version: int
    fields: Mapping[str, Array]

    def numbers(self, name: str, *shape: int, among: tuple[str, ...] = ("f32", "f64")) -> Array:
        """Return a field as numbers of 64 bits, all of them finite.

        Args:
            name: Of the field.
            shape: That it has to have.
            among: Types that it may have.

        Raises:
            BadMessage: it lacks, is of another type or shape, or holds what is no number.
        """
        found = self._field(name, shape, among).astype(np.float64)
        if not np.isfinite(found).all():
            raise BadMessage("not-finite", f"a number of {name} is not finite")
        return found

    def few(self, name: str, count: int, *, among: tuple[str, ...] = ("f32", "f64")) -> list[float]:
        """Return a field of a few numbers, for which NumPy is slow; raises as `numbers` does."""
        found: list[float] = self._field(name, (count,), among).tolist()
        if not all(map(math.isfinite, found)):
            raise BadMessage("not-finite", f"a number of {name} is not finite")
        return found

    def number(self, name: str, default: float, *, among: tuple[str, ...] = ("f32", "f64")) -> float:
        """Return a field of one number, or a default where it lacks; raises as `numbers` does."""
        return self.few(name, 1, among=among)[0] if name in self.fields else default

    def _field(self, name: str, shape: tuple[int, ...], among: tuple[str, ...]) -> Array:
        array = self.fields.get(name)
        if array is None:
            raise BadMessage("wrong-fields", f"field {name} lacks; there are {', '.join(self.fields) or 'none'}")
        dtype = _NAMES[array.dtype.str[1:]]
        if dtype not in among or array.shape != shape:
            raise BadMessage(
                "wrong-fields",
                f"field {name} is {dtype} {list(array.shape)}, expected {' or '.join(among)} {list(shape)}",
            )
        return array


def pack(topic: str, version: int, fields: Mapping[str, Array]) -> bytes:
    """Return a message.

    Args:
        topic: Of the message.
        version: Of its protocol.
        fields: Arrays by name, in the order of their bytes.

    Raises:
        ValueError: more fields than the header has room for, or an array of another type.
    """
    listed = []
    for name, array in fields.items():
        if (dtype := _NAMES.get(array.dtype.str[1:])) is None:
            raise ValueError(f"field {name} is of {array.dtype}; expected one of {', '.join(_DTYPES)}")
        listed.append({"name": name, "dtype": dtype, "shape": list(array.shape)})
    told = {"v": version, "endian": "le", "count": 1, "fields": listed}
    header = json.dumps(told, separators=(",", ":")).encode()
    if len(header) > HEADER_BYTES:
        raise ValueError(f"a header of {len(header)} bytes; there is room for {HEADER_BYTES}")
    payload = b"".join(array.astype(array.dtype.newbyteorder("<")).tobytes() for array in fields.values())
    return topic.encode() + header.ljust(HEADER_BYTES, b"\0") + payload


def topic_of(data: bytes, topics: tuple[str, ...]) -> str:
    """Return which of some topics a message is of, or ""."""
    return next((topic for topic in topics if data.startswith(topic.encode() + b"{")), "")


def parse(topic: str, data: bytes) -> Message:
    """Return what a message of a topic says.

    Raises:
        BadMessage: it is none.
    """
    if len(data) > MOST_BYTES:
        raise BadMessage("wrong-length", f"{len(data)} bytes, expected at most {MOST_BYTES}")
    start = len(topic)
    end = start + HEADER_BYTES
    if len(data) < end:
        raise BadMessage("wrong-length", f"{len(data)} bytes, expected at least {end}: topic and header")
    if data[:start] != topic.encode():
        raise BadMessage("wrong-header", f"begins with {data[:start]!r}, expected {topic}")
    text, _, rest = data[start:end].partition(b"\0")
    if rest.strip(b"\0"):
        raise BadMessage("wrong-header", "something stands behind the end of the header")
    try:
        header = _HEADERS.decode(text)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadMessage("wrong-header", f"header: {error}") from None
    if len(header.fields) > _MOST_FIELDS or header.endian not in _ORDER:
        raise BadMessage(
            "wrong-header",
            f"{len(header.fields)} fields, endian {header.endian!r}; expected at most {_MOST_FIELDS}, le",
        )
    return Message(header.v, _fields(header, data, end))


def _fields(header: _Header, data: bytes, start: int) -> dict[str, Array]:
    found: dict[str, Array] = {}
    for field in header.fields:
        order = _ORDERED.get((header.endian, field.dtype))
        dimensions = 0 < len(field.shape) <= _MOST_DIMENSIONS and all(0 < size <= MOST_BYTES for size in field.shape)
        if order is None or not dimensions or field.name in found:
            raise BadMessage("wrong-header", f"field {field.name!r}: {field.dtype!r} {field.shape}, or twice")
        count = math.prod(field.shape)
        if count * order.itemsize > len(data) - start:
            raise BadMessage("wrong-length", f"field {field.name!r}: {field.shape} is more than there is")
        found[field.name] = np.frombuffer(data, order, count, start).reshape(field.shape)
        start += count * order.itemsize
    if start != len(data):
        raise BadMessage("wrong-length", f"{len(data) - start} bytes behind the last field")
    return found
