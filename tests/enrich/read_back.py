"""Reads an enriched file with nothing of ours: the reader of `mcap`, and protobuf by the schema in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap.records import Channel, Schema


class Decoded(NamedTuple):
    """A message, its times [ns] and number, and its channel and schema."""

    message: Any
    log_ns: int
    publish_ns: int
    sequence: int
    channel: Channel
    schema: Schema


def decoded(path: Path, topic: str) -> list[Decoded]:
    """Return every message of a topic in file order."""
    classes: dict[int, Any] = {}
    found = []
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(topics=[topic], log_time_order=False):
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            if schema.id not in classes:
                classes[schema.id] = class_of(schema)
            value = classes[schema.id].FromString(message.data)
            found.append(Decoded(value, message.log_time, message.publish_time, message.sequence, channel, schema))
    return found


def topics(path: Path) -> dict[str, str]:
    """Return the schema name of each topic."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}


def class_of(schema: Schema) -> Any:
    """Return the class of a schema's messages."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))


def comments(schema: Schema) -> dict[str, str]:
    """Return what stands beside each field of a message type."""
    (file,) = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
    fields = file.message_type[0].field
    return {
        fields[place.path[3]].name: place.leading_comments.strip()
        for place in file.source_code_info.location
        if list(place.path[:3]) == [4, 0, 2]
    }
