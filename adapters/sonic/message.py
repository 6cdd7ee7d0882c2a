"""GEAR-SONIC's packed message: a topic, 1280 bytes of JSON that list the fields, then their numbers. Pure.

::

    topic      "command", "planner", "pose"; no end of its own, the header begins with "{"
    header     1280 bytes: {"v": 1, "endian": "le", "count": 1, "fields": [{"name", "dtype", "shape"}, …]}, then zeros
    payload    the fields' numbers in that order, with nothing between or behind them

Numbers are ``f32``, ``f64``, ``i32``, ``i64``, ``u8`` or ``bool``. The shape is what a stranger says: nothing is made
of that size before the bytes that there are have been compared with it.
"""

from __future__ import annotations

import functools
import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

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
_CODES = {"f4": "f", "f8": "d", "i4": "i", "i8": "q", "u1": "B"}  # of struct
_ORDER = {"le": "<", "be": ">", "": "<"}
_MOST_FIELDS, _MOST_DIMENSIONS = 32, 4
_LAYOUTS = 64  # that are remembered: a stream's messages have one header, but for a field that comes and goes


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


class _Place(NamedTuple):
    """Where the numbers of a field are, in bytes behind the header."""

    dtype: np.dtype[Any]
    code: str
    shape: tuple[int, ...]
    start: int


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """What a header says."""

    version: int
    places: Mapping[str, _Place]
    names: frozenset[str]
    size: int


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """What a message says."""

    _layout: _Layout
    _data: bytes
    _start: int

    @property
    def version(self) -> int:
        """Of the topic's protocol."""
        return self._layout.version

    @property
    def names(self) -> frozenset[str]:
        """Of its fields."""
        return self._layout.names

    @property
    def fields(self) -> dict[str, Array]:
        """Numbers by the name of their field, each in its shape; ``bool`` as 0 and others."""
        return {name: self._array(place) for name, place in self._layout.places.items()}

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a field, () where it lacks."""
        place = self._layout.places.get(name)
        return () if place is None else place.shape

    def numbers(self, name: str, *shape: int, among: tuple[str, ...] = ("f32", "f64")) -> Array:
        """Return a field as numbers of 64 bits, all of them finite.

        Args:
            name: Of the field.
            shape: That it has to have.
            among: Types that it may have.

        Raises:
            BadMessage: it lacks, is of another type or shape, or holds what is no number.
        """
        found = self._array(self._place(name, shape, among)).astype(np.float64)
        if not np.isfinite(found).all():
            raise BadMessage("not-finite", f"a number of {name} is not finite")
        return found

    def few(self, name: str, count: int, *, among: tuple[str, ...] = ("f32", "f64")) -> list[float]:
        """Return a field of a few numbers, for which NumPy is slow; raises as `numbers` does."""
        place = self._place(name, (count,), among)
        found = struct.unpack_from(place.code, self._data, self._start + place.start)
        if not all(map(math.isfinite, found)):
            raise BadMessage("not-finite", f"a number of {name} is not finite")
        return list(found)

    def number(self, name: str, default: float, *, among: tuple[str, ...] = ("f32", "f64")) -> float:
        """Return a field of one number, or a default where it lacks; raises as `numbers` does."""
        return self.few(name, 1, among=among)[0] if name in self.names else default

    def _place(self, name: str, shape: tuple[int, ...], among: tuple[str, ...]) -> _Place:
        place = self._layout.places.get(name)
        if place is None:
            there = ", ".join(self._layout.places) or "none"
            raise BadMessage("wrong-fields", f"field {name} lacks; there are {there}")
        dtype = _NAMES[place.dtype.str[1:]]
        if dtype not in among or place.shape != shape:
            raise BadMessage(
                "wrong-fields",
                f"field {name} is {dtype} {list(place.shape)}, expected {' or '.join(among)} {list(shape)}",
            )
        return place

    def _array(self, place: _Place) -> Array:
        start, count = self._start + place.start, math.prod(place.shape)
        return np.frombuffer(self._data, place.dtype, count, start).reshape(place.shape)


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
    layout = _layout(data[start:end])
    if (there := len(data) - end) != layout.size:
        raise BadMessage("wrong-length", f"{there} bytes behind the header, whose fields take {layout.size}")
    return Message(layout, data, end)


@functools.lru_cache(_LAYOUTS)
def _layout(data: bytes) -> _Layout:
    """Return what the bytes of a header say; raises as `parse`, which is not remembered."""
    text, _, rest = data.partition(b"\0")
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
    order, places, start = _ORDER[header.endian], dict[str, _Place](), 0
    for field in header.fields:
        kind = _DTYPES.get(field.dtype)
        dimensions = 0 < len(field.shape) <= _MOST_DIMENSIONS and all(0 < size <= MOST_BYTES for size in field.shape)
        if kind is None or not dimensions or field.name in places:
            raise BadMessage("wrong-header", f"field {field.name!r}: {field.dtype!r} {field.shape}, or twice")
        dtype, count = np.dtype(order + kind), math.prod(field.shape)
        places[field.name] = _Place(dtype, f"{order}{count}{_CODES[kind]}", tuple(field.shape), start)
        start += count * dtype.itemsize
    return _Layout(header.v, places, frozenset(places), start)
