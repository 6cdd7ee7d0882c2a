"""What a key of a running station is to a viewer: its topics, and a value of it as their messages.

Topics and messages are those of a recording, by the same functions, so what was arranged for one shows the other:

=====================  ==============================================  ==============================================
topic                  message type                                    for
=====================  ==============================================  ==============================================
``KEY/typed``, …       as in an enriched recording                     named vectors, events, pictures, poses
                       (`station.enrich.siblings`)
``KEY``                ``foxglove.PointCloud``, as in ``clouds.mcap``  clouds of a lidar
``KEY``                JSON: an object byte for byte as on the bus;    all others, also keys that nothing describes
                       any other value in ``{"value": …}``
=====================  ==============================================  ==============================================

JSON objects stay JSON: which scalars they hold is known of a recording that was read to its end, and not of a key that
nobody has looked at yet.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np

from station import point_cloud
from station.bus import codec
from station.bus.sample import Sample
from station.clock import Clock
from station.contract import Contract
from station.enrich.scalars import Shape
from station.enrich.siblings import Encode, siblings
from station.episode.reading.frames import captured_ns
from station.episode.reading.messages import Channel, Message
from station.episode.reading.vectors import decoder
from station.episode.storage import layout, pictures
from station.episode.storage.channels import topic_of
from station.protobuf import foxglove
from station.protobuf.schema import ENCODING

JSON, JSON_SCHEMA = "json", "jsonschema"
ROWS = "f64-rows"

_LATEST_NS = 1 << 63
_ROW_BYTES = 8  # of each of its numbers


class Topic(NamedTuple):
    """A topic of a key: its name, how its messages are encoded, and their schema."""

    name: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


class LiveKey:
    """Topics of a key, and its values as their messages.

    Args:
        key: The key.
        contract: What it holds; None where nothing describes it.
        type_name: Full name for a message type of its own; no other key's (`station.enrich.vector.TypeNames`).

    Attributes:
        contract: As given.
        topics: Of the key, one or more.
    """

    def __init__(self, key: str, contract: Contract | None, type_name: str) -> None:
        self.contract = contract
        name = topic_of(key)
        known = None if contract is None else msgspec.structs.replace(contract, key=name)
        self._channel = Channel(
            id=0, topic=name, source="", writer=layout.FOREIGN, encoding=layout.BYTES, contract=known
        )
        typed = None if known is None else _typed(known, type_name)
        self.topics: list[Topic]
        self._encode: Encode
        if typed is None:
            self.topics, self._encode = [_json_topic(name, known)], _as_json(known)
        else:
            self.topics, self._encode = typed

    def encode(self, sample: Sample, written_ns: int) -> list[bytes] | None:
        """Return the message for each topic; None where a value is not what the key is described to hold.

        Args:
            sample: The value.
            written_ns: When it was written [ns since the epoch], see `written_wall_ns`.
        """
        mark = None if sample.stamp is None else sample.stamp.encode()
        return self._encode(Message(self._channel.topic, sample.value, written_ns, written_ns, 0, self._channel, mark))


def written_wall_ns(sample: Sample, clock: Clock) -> int:
    """Return when a value was written [ns since the epoch].

    It is what its stamp says; of a writer on another machine, whose clock is known here, the same instant by this
    machine's clock. Without a stamp it is when the value arrived, and now where that is unknown.
    """
    mark = sample.stamp
    is_ours = mark is not None and (mark.is_from_this_boot or sample.clock is None)
    if mark is not None and is_ours and 0 <= mark.wall_ns < _LATEST_NS:
        return mark.wall_ns
    at_ns, now_ns = sample.arrived_ns, clock.monotonic_ns()
    if mark is not None and not is_ours:
        at_ns = sample.written_ns
    age_ns = 0 if at_ns is None else now_ns - at_ns
    return min(max(0, clock.wall_ns() - age_ns), _LATEST_NS - 1)


def _typed(contract: Contract, type_name: str) -> tuple[list[Topic], Encode] | None:
    """Return topics and messages of protobuf; None where the key gets none."""
    if contract.codec == "point-cloud":
        schema = foxglove.schema(foxglove.POINT_CLOUD)
        return [Topic(contract.key, ENCODING, schema.name, ENCODING, schema.data)], _cloud
    made = siblings(contract, Shape(), type_name)
    if isinstance(made, str):
        return None
    topics = [Topic(name, ENCODING, schema.name, ENCODING, schema.data) for name, schema in made.topics]
    return topics, _newest_row(made.encode, len(contract.elements)) if contract.codec == ROWS else made.encode


def _newest_row(encode: Encode, length: int) -> Encode:
    """Return what makes messages of the last of a value's rows, of so many numbers."""
    size = length * _ROW_BYTES

    def newest(message: Message) -> list[bytes] | None:
        if not message.data or len(message.data) % size:
            return None
        return encode(message._replace(data=message.data[-size:]))

    return newest


def _cloud(message: Message) -> list[bytes] | None:
    try:
        point_cloud.decoded(message.data)
    except point_cloud.BadCloud:
        return None
    return [pictures.time_before(captured_ns(message)) + message.data]


def _json_topic(name: str, contract: Contract | None) -> Topic:
    note = "nothing describes this key" if contract is None else contract.note
    schema = {"title": name, "description": note, "type": "object"}
    return Topic(name, JSON, name, JSON_SCHEMA, msgspec.json.encode(schema))


def _as_json(contract: Contract | None) -> Callable[[Message], list[bytes] | None]:
    form = "json" if contract is None else contract.codec
    if form == "text":
        return _text
    if form not in ("f32", "f64", ROWS):
        return _json
    decode = decoder(form)

    def numbers(message: Message) -> list[bytes] | None:
        values = decode(message.data)
        if values is None:
            return None
        return [msgspec.json.encode({"value": values.tolist() if isinstance(values, np.ndarray) else values})]

    return numbers


def _json(message: Message) -> list[bytes] | None:
    """Return a JSON value as an object, which is all that a viewer takes; an object as it is."""
    try:
        value = codec.parse_json(message.data)
    except codec.BadValue:
        return None
    return [message.data if isinstance(value, dict) else b'{"value":' + message.data + b"}"]


def _text(message: Message) -> list[bytes] | None:
    try:
        return [msgspec.json.encode({"value": message.data.decode()})]
    except UnicodeDecodeError:
        return None
