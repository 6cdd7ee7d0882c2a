"""Values of the bus as bytes, and back.

TWIST's vectors are JSON text exactly as Python's own encoder writes it; ours are raw little-endian numbers.

Any client may write any bytes, so every decoder here bounds what it returns, and whatever lies beyond is a `BadValue`:
an integer fits in 64 bits (a larger one is no float, no column and no argument of a system call), values nest at most
`MAX_DEPTH` deep (what decodes at a depth of 900 may not encode again) and JSON is at most `MAX_BYTES` long.
"""

from __future__ import annotations

import json
import math
import re
import sys
import threading
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from station.contract import VectorCodec

if TYPE_CHECKING:  # imported where vectors are made: it would double the time of `station estop`
    import numpy as np
    from numpy.typing import NDArray

T = TypeVar("T")

_decode_list = msgspec.json.Decoder(list[float]).decode
_encode = msgspec.json.Encoder().encode
_decoders: dict[Any, msgspec.json.Decoder[Any]] = {}
_one_learns = threading.Lock()

MAX_BYTES = 1 << 20
"""Of a JSON value; the longest of ours, what a G1's server states, has 16 kB."""

MAX_DEPTH = 64
"""Of lists and objects within each other; the deepest of ours has 6."""

LARGEST_INTEGER = (1 << 63) - 1
"""The smallest integer is its negative, less one."""

_LONG_NUMBER = re.compile(rb"\d{19}")  # 9223372036854775807 has 19 digits
_LONGEST_REASON = 200


class BadValue(ValueError):
    """Bytes that do not hold what the key's contract says; the message says what came."""


class BadNumber(BadValue):
    """A number that is none to calculate with: not finite, or an integer of more than 64 bits."""


def json_vector(values: Sequence[float] | NDArray[Any]) -> bytes:
    """Encode a flat vector byte for byte as ``json.dumps(list)`` does, about ten times faster."""
    numbers = list(values) if isinstance(values, Sequence) else values.tolist()
    fast = _encode(numbers)
    # The two encoders agree except on exponents: where one writes 1e-05 the other writes 0.00001 or 1e-5,
    # and on NaN and infinities, which the fast one turns into null.
    if b"e" in fast or b"0.0000" in fast or b"null" in fast:
        return json.dumps(numbers).encode()
    return fast.replace(b",", b", ")


def parse_json_numbers(data: bytes, length: int | None = None) -> list[float]:
    """Decode a flat JSON list of finite numbers.

    Raises:
        BadNumber: one of the numbers is not finite, or too large.
        BadValue: not JSON, not a flat list of numbers, or wrong length.
    """
    _check_length(data)
    try:
        numbers = _decode_list(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise _why_not_a_vector(data) from None
    if length is not None and len(numbers) != length:
        raise BadValue(f"{len(numbers)} values, expected {length}")
    return numbers


def parse_json_vector(data: bytes, length: int | None = None) -> NDArray[np.float64]:
    """Decode a flat JSON list of finite numbers, shape (length,); raises as `parse_json_numbers` does."""
    vector: NDArray[np.float64] = _numpy().array(parse_json_numbers(data, length), float)
    return vector


def f64(values: Sequence[float] | NDArray[Any]) -> bytes:
    """Encode a vector as little-endian float64."""
    return _raw(values, "<f8")


def f32(values: Sequence[float] | NDArray[Any]) -> bytes:
    """Encode a vector as little-endian float32."""
    return _raw(values, "<f4")


def parse_f64(data: bytes) -> NDArray[np.float64]:
    """Decode little-endian float64."""
    return _parse_raw(data, "<f8", "=f8")


def parse_f32(data: bytes) -> NDArray[np.float32]:
    """Decode little-endian float32."""
    return _parse_raw(data, "<f4", "=f4")


def vector(kind: VectorCodec, values: Sequence[float] | NDArray[Any]) -> bytes:
    """Encode a vector as a key's contract says."""
    return {"json-vector": json_vector, "f64": f64, "f32": f32}[kind](values)


def parse_vector(kind: VectorCodec, data: bytes) -> NDArray[np.float64]:
    """Decode a vector as a key's contract says, shape (m,).

    Raises:
        BadValue: the bytes are no such vector.
    """
    if kind == "json-vector":
        return parse_json_vector(data)
    return parse_f64(data) if kind == "f64" else parse_f32(data).astype("=f8")


def json_object(value: Any) -> bytes:
    """Encode a struct, dict or list as compact JSON."""
    return _encode(value)


def parse_json(data: bytes) -> Any:
    """Decode any JSON, with Python's ``NaN`` and ``Infinity`` tokens.

    Raises:
        BadNumber: an integer of more than 64 bits.
        BadValue: not JSON in UTF-8, text in it that no file could hold (half a surrogate pair), too long or too deep.
    """
    _check_length(data)
    try:
        value = _decode(data.decode())
        if b"\\u" in data:
            json.dumps(value, ensure_ascii=False).encode()
    except BadNumber:
        raise
    except (ValueError, RecursionError) as error:
        raise BadValue(f"not JSON: {_short(data)}") from error
    if _may_be_deep(data) and not is_modest(value, values=len(data), depth=MAX_DEPTH):
        raise BadValue(f"lists and objects nest deeper than {MAX_DEPTH}: {_short(data)}")
    return value


def parse_struct(data: bytes, kind: type[T]) -> T:
    """Decode JSON into a type that msgspec knows.

    Raises:
        BadNumber: an integer of more than 64 bits.
        BadValue: not JSON, not of that type, too long or too deep.
    """
    _check_length(data)
    try:
        value = _decoder(kind).decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadValue(str(error)[:_LONGEST_REASON]) from error
    if _may_be_deep(data) or _LONG_NUMBER.search(data):
        parse_json(data)  # the other decoder knows no bounds, so this one judges what may be beyond them
    return value


def _decoder(kind: type[T]) -> msgspec.json.Decoder[T]:
    """Return the decoder of a type.

    msgspec learns a type when it is first used, and crashes where two threads do so at once: here one does.
    """
    found = _decoders.get(kind)
    if found is None:
        with _one_learns:
            found = _decoders.setdefault(kind, msgspec.json.Decoder(kind))
    return found


def parse_facts(data: bytes | None) -> dict[str, Any]:
    """Decode a JSON object; other bytes, or none, give an empty one."""
    try:
        value = parse_json(data) if data is not None else None
    except BadValue:
        return {}
    return value if isinstance(value, dict) else {}


def number(value: object) -> float | None:
    """Return a decoded value as a finite float; None where it is no number, as true and false are none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return float(value) if abs(value) <= sys.float_info.max else None


def is_modest(value: Any, *, values: int = 20_000, depth: int = 32) -> bool:
    """Whether decoded JSON is small and shallow enough to be kept and written out again in another form."""
    level, count = [value], 1
    for _ in range(depth):
        inner = [item.values() if isinstance(item, dict) else item for item in level if isinstance(item, (dict, list))]
        level = [below for items in inner for below in items]
        count += len(level)
        if not level or count > values:
            break
    return not level and count <= values


@cache
def _numpy() -> Any:
    """Load NumPy with the first array: an import in each call takes as long as a short vector."""
    import numpy as np

    return np


def _raw(values: Sequence[float] | NDArray[Any], layout: str) -> bytes:
    data: bytes = _numpy().ascontiguousarray(values, layout).tobytes()
    return data


def _parse_raw(data: bytes, layout: str, kind: str) -> NDArray[Any]:
    size = int(layout[-1])
    if len(data) % size:
        raise BadValue(f"{len(data)} bytes, expected a multiple of {size}")
    vector: NDArray[Any] = _numpy().frombuffer(data, layout).astype(kind)
    return vector


def _why_not_a_vector(data: bytes) -> BadValue:
    try:
        value = parse_json(data)
    except BadValue as error:
        return error
    if not isinstance(value, list):
        return BadValue(f"a JSON {type(value).__name__}, expected a list of numbers")
    for index, item in enumerate(value):
        if isinstance(item, bool) or not isinstance(item, (int, float)):
            return BadValue(f"element {index} is {_short(json.dumps(item).encode())}, expected a number")
        if not math.isfinite(item):
            return BadNumber(f"element {index} is {item}, expected a finite number")
    return BadValue(f"not a list of numbers: {_short(data)}")


def _check_length(data: bytes) -> None:
    if len(data) > MAX_BYTES:
        raise BadValue(f"{len(data)} bytes of JSON, expected at most {MAX_BYTES}")


def _may_be_deep(data: bytes) -> bool:
    return data.count(b"[") + data.count(b"{") > MAX_DEPTH


def _integer(digits: str) -> int:
    if len(digits) > len(str(-LARGEST_INTEGER)):
        raise BadNumber(f"an integer of {len(digits)} digits, expected at most 64 bits")
    value = int(digits)
    if not -LARGEST_INTEGER - 1 <= value <= LARGEST_INTEGER:
        raise BadNumber(f"the integer {value}, expected at most 64 bits")
    return value


_decode = json.JSONDecoder(parse_int=_integer).decode


def _short(data: bytes) -> str:
    return repr(data[:40].decode("utf-8", "replace")) + ("…" if len(data) > 40 else "")
