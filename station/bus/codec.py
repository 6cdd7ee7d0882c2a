"""Values of the bus as bytes, and back.

TWIST's vectors are JSON text exactly as Python's own encoder writes it; ours are raw little-endian numbers.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

_decode_list = msgspec.json.Decoder(list[float]).decode
_encode = msgspec.json.Encoder().encode


class BadValue(ValueError):
    """Bytes that do not hold what the key's contract says; the message says what came."""


def json_vector(values: Sequence[float] | NDArray[Any]) -> bytes:
    """Encode a flat vector byte for byte as ``json.dumps(list)`` does, about ten times faster."""
    numbers = values.tolist() if isinstance(values, np.ndarray) else list(values)
    fast = _encode(numbers)
    # The two encoders agree except on exponents: where one writes 1e-05 the other writes 0.00001 or 1e-5,
    # and on NaN and infinities, which the fast one turns into null.
    if b"e" in fast or b"0.0000" in fast or b"null" in fast:
        return json.dumps(numbers).encode()
    return fast.replace(b",", b", ")


def parse_json_vector(data: bytes, length: int | None = None) -> NDArray[np.float64]:
    """Decode a flat JSON list of finite numbers, shape (length,).

    Raises:
        BadValue: not JSON, not a flat list of numbers, wrong length, or not finite.
    """
    try:
        numbers = _decode_list(data)
    except msgspec.DecodeError:
        raise BadValue(_why_not_a_vector(data)) from None
    if length is not None and len(numbers) != length:
        raise BadValue(f"{len(numbers)} values, expected {length}")
    return np.array(numbers, dtype=np.float64)


def f64(values: Sequence[float] | NDArray[Any]) -> bytes:
    """Encode a vector as little-endian float64."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def f32(values: Sequence[float] | NDArray[Any]) -> bytes:
    """Encode a vector as little-endian float32."""
    return np.ascontiguousarray(values, dtype="<f4").tobytes()


def parse_f64(data: bytes) -> NDArray[np.float64]:
    """Decode little-endian float64."""
    return _parse_raw(data, "<f8", np.float64)


def parse_f32(data: bytes) -> NDArray[np.float32]:
    """Decode little-endian float32."""
    return _parse_raw(data, "<f4", np.float32)


def json_object(value: Any) -> bytes:
    """Encode a struct, dict or list as compact JSON."""
    return _encode(value)


def parse_json(data: bytes) -> Any:
    """Decode any JSON, with Python's ``NaN`` and ``Infinity`` tokens.

    Raises:
        BadValue: not JSON, or text in it that no file could hold (half a surrogate pair).
    """
    try:
        value = json.loads(data)
        if b"\\u" in data:
            json.dumps(value, ensure_ascii=False).encode()
        return value
    except (ValueError, RecursionError) as error:
        raise BadValue(f"not JSON: {_short(data)}") from error


def parse_struct(data: bytes, kind: type[T]) -> T:
    """Decode JSON into a type that msgspec knows.

    Raises:
        BadValue: not JSON, or not of that type.
    """
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadValue(str(error)) from error


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


def _parse_raw(data: bytes, layout: str, kind: Any) -> NDArray[Any]:
    size = np.dtype(layout).itemsize
    if len(data) % size:
        raise BadValue(f"{len(data)} bytes, expected a multiple of {size}")
    return np.frombuffer(data, dtype=layout).astype(kind)


def _why_not_a_vector(data: bytes) -> str:
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return f"not JSON: {_short(data)}"
    if not isinstance(value, list):
        return f"a JSON {type(value).__name__}, expected a list of numbers"
    for index, item in enumerate(value):
        if isinstance(item, bool) or not isinstance(item, (int, float)):
            return f"element {index} is {_short(json.dumps(item).encode())}, expected a number"
        if not math.isfinite(item):
            return f"element {index} is {item}, expected a finite number"
    return f"not a list of numbers: {_short(data)}"


def _short(data: bytes) -> str:
    return repr(data[:40].decode("utf-8", "replace")) + ("…" if len(data) > 40 else "")
