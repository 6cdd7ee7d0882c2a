"""Protobuf message types made while the program runs: no .proto file, no compiler.

A `Schema` is what a reader needs to decode a message, as an MCAP file carries it: the full name of the message type,
and the serialized ``FileDescriptorSet`` with every type that it is made of.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

ENCODING = "protobuf"
TIMESTAMP = "google.protobuf.Timestamp"
MOST_FIELDS = 2000

_Proto = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    "double": _Proto.TYPE_DOUBLE,
    "bool": _Proto.TYPE_BOOL,
    "int64": _Proto.TYPE_INT64,
    "fixed32": _Proto.TYPE_FIXED32,
    "string": _Proto.TYPE_STRING,
    "bytes": _Proto.TYPE_BYTES,
}
_FIELDS_IN_MESSAGE, _FIELD_TAG = 4, 2  # numbers of `message_type` in a file, and of `field` in a message type
_TIMESTAMP_FILE = "google/protobuf/timestamp.proto"


class Field(NamedTuple):
    """One field of a message type.

    Attributes:
        name: Its name.
        number: Its number on the wire, from 1.
        type: ``double``, ``bool``, ``int64``, ``fixed32``, ``string``, ``bytes``, else the full name of a message type,
            or of an enumeration with ``enum:`` before it.
        comment: Stands beside the field in the schema: its unit.
        is_optional: Whether a message can do without it, told apart from zero.
        is_repeated: Whether it is a list.
    """

    name: str
    number: int
    type: str
    comment: str = ""
    is_optional: bool = False
    is_repeated: bool = False


class Schema(NamedTuple):
    """Full name of a message type, and its serialized ``FileDescriptorSet``."""

    name: str
    data: bytes


def schema(name: str, fields: Sequence[Field], comment: str = "") -> Schema:
    """Return the schema of a message type that needs no other.

    Args:
        name: Full name, such as ``station.RobotState``.
        fields: Its fields.
        comment: Stands above the type.

    Raises:
        ValueError: a name is none, or two fields share a name or a number.
    """
    made = Schema(name, file_set([message_file(name, fields, comment=comment)]))
    message_class(made)  # the library is the judge of names and numbers
    return made


def message_file(
    name: str, fields: Sequence[Field], *, comment: str = "", enums: Iterable[tuple[str, Sequence[str]]] = ()
) -> Any:
    """Return the ``FileDescriptorProto`` that declares one message type; types that it uses have files of that kind.

    Args:
        name: Full name; the file is called after it.
        fields: Its fields.
        comment: Stands above the type.
        enums: Enumerations within the type: name and names of the values, numbered from 0.
    """
    package, _, short = name.rpartition(".")
    file = descriptor_pb2.FileDescriptorProto(name=file_name(name), package=package, syntax="proto3")
    message = file.message_type.add(name=short)
    for field in fields:
        _add_field(message, field)
    used = {field.type for field in fields if "." in field.type and not field.type.startswith("enum:")}
    file.dependency.extend(sorted(file_name(other) for other in used))
    for enum, values in enums:
        declared = message.enum_type.add(name=enum)
        for number, value in enumerate(values):
            declared.value.add(name=value, number=number)
    _add_comments(file, comment, fields)
    return file


def file_name(name: str) -> str:
    """Return the name of the file that declares a message type."""
    return _TIMESTAMP_FILE if name == TIMESTAMP else name.replace(".", "/") + ".proto"


def timestamp_file() -> Any:
    """Return the file that declares the well-known time stamp."""
    found = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(found)
    return found


def file_set(files: Iterable[Any]) -> bytes:
    """Serialize files, each after those that it uses."""
    return bytes(descriptor_pb2.FileDescriptorSet(file=files).SerializeToString())


def message_class(made: Schema) -> Any:
    """Return a class whose objects are messages of a schema.

    Raises:
        ValueError: the schema does not hold together.
    """
    pool = descriptor_pool.DescriptorPool()
    try:
        for file in descriptor_pb2.FileDescriptorSet.FromString(made.data).file:
            pool.Add(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(made.name))
    except (TypeError, KeyError) as error:
        raise ValueError(f"{made.name}: no message type can be made of its fields: {error}") from error


def _add_field(message: Any, field: Field) -> None:
    label = _Proto.LABEL_REPEATED if field.is_repeated else _Proto.LABEL_OPTIONAL
    added = message.field.add(name=field.name, number=field.number, label=label)
    if field.type in _SCALARS:
        added.type = _SCALARS[field.type]
    else:
        is_enum = field.type.startswith("enum:")
        added.type = _Proto.TYPE_ENUM if is_enum else _Proto.TYPE_MESSAGE
        added.type_name = "." + field.type.removeprefix("enum:")
    if field.is_optional:  # proto3 writes that as a choice of one
        added.proto3_optional, added.oneof_index = True, len(message.oneof_decl)
        message.oneof_decl.add(name=f"_{field.name}")


def _add_comments(file: Any, comment: str, fields: Sequence[Field]) -> None:
    places = [([_FIELDS_IN_MESSAGE, 0], comment)]
    places += [([_FIELDS_IN_MESSAGE, 0, _FIELD_TAG, index], field.comment) for index, field in enumerate(fields)]
    for path, text in places:
        if text:
            file.source_code_info.location.add(path=path, span=[0, 0, 0], leading_comments=f" {text}\n")
