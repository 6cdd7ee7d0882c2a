"""Recorded bytes as arrays of numbers, by the contract that was recorded with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from station.contract import Codec, Contract
from station.episode.reading.messages import Message, Vectors
from station.errors import EpisodeError

Row = Sequence[Any] | NDArray[Any]

_decode_list = msgspec.json.Decoder(list[float]).decode
_decode_integer = msgspec.json.Decoder(int).decode
_INT64 = 1 << 63
_TYPES: dict[str, Any] = {"json-vector": np.float64, "f64": np.float64, "f32": np.float32, "integer": np.int64}


def numbers(topic: str, messages: Sequence[Message]) -> tuple[Vectors, int]:
    """Return the numbers of messages of one topic, and how many values did not fit.

    A value fits when it decodes and is as long as the contract says, or, where the contract names no elements, as the
    first one that decodes. A value of many rows gives as many.

    Raises:
        EpisodeError: the topic was recorded without a contract, or with one that holds no numbers.
    """
    writes = [message for message in messages if not message.channel.is_deletion]
    contract = next((message.channel.contract for message in writes if message.channel.contract), None)
    if not writes:
        return Vectors(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 0))), 0
    if contract is not None and contract.codec == "f64-rows":
        return _rows(contract, writes)
    if contract is None or contract.codec not in _TYPES:
        holds = "no contract" if contract is None else f"values of kind {contract.codec}"
        raise EpisodeError(f"{topic}: {holds}, so no numbers; read its messages instead")
    found = fitting(contract, (message.data for message in writes))
    kept = [message for message, row in zip(writes, found, strict=True) if row is not None]
    rows = [row for row in found if row is not None]
    width = len(rows[0]) if rows else len(contract.elements)
    values = np.array(rows, dtype=_TYPES[contract.codec]).reshape(len(rows), width)
    log_ns = np.fromiter((message.log_ns for message in kept), np.int64, len(kept))
    publish_ns = np.fromiter((message.publish_ns for message in kept), np.int64, len(kept))
    return Vectors(log_ns, publish_ns, values), len(writes) - len(kept)


def _rows(contract: Contract, writes: Sequence[Message]) -> tuple[Vectors, int]:
    """Return the rows of all messages, one below the other, each at the times of its message."""
    width = len(contract.elements)
    fit = [message for message in writes if width and len(message.data) % (8 * width) == 0]
    tables = [np.frombuffer(message.data, "<f8").reshape(-1, width) for message in fit]
    counts = [len(table) for table in tables]
    values = np.concatenate(tables) if tables else np.empty((0, width))
    times = (np.array([getattr(message, name) for message in fit], np.int64) for name in ("log_ns", "publish_ns"))
    log_ns, publish_ns = (np.repeat(each, counts) for each in times)
    return Vectors(log_ns, publish_ns, values), len(writes) - len(fit)


def fitting(contract: Contract, values: Iterable[bytes | None]) -> list[Row | None]:
    """Return the numbers of each value, all of one length; None for one that does not fit, and for None."""
    decode = decoder(contract.codec)
    length = len(contract.elements) or None
    rows: list[Row | None] = []
    for value in values:
        row = decode(value) if value is not None else None
        if row is not None and length is not None and len(row) != length:
            row = None
        if row is not None:
            length = len(row)
        rows.append(row)
    return rows


def decoder(codec: Codec) -> Callable[[bytes], Row | None]:
    """Return what makes numbers of the bytes of one value; it returns None for bytes that hold none."""
    if codec == "json-vector":
        return _json_vector
    if codec == "integer":
        return _integer
    layout = np.dtype("<f4" if codec == "f32" else "<f8")

    def raw(data: bytes) -> NDArray[Any] | None:
        return np.frombuffer(data, layout) if len(data) % layout.itemsize == 0 else None

    return raw


def _json_vector(data: bytes) -> list[float] | None:
    try:
        return _decode_list(data)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def _integer(data: bytes) -> list[int] | None:
    try:
        value = _decode_integer(data)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
    return [value] if -_INT64 <= value < _INT64 else None
