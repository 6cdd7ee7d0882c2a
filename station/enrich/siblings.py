"""Which typed topics a key gets, and how a value of it becomes their messages.

=============  =========================================================  =============================================
topic          message type                                               for
=============  =========================================================  =============================================
``KEY/typed``  ``station.<Key>``, a double per element as its contract    every vector whose elements have names
               names them, the unit as the field's comment
``KEY/typed``  ``station.<Key>``, an optional field per scalar            JSON objects, but for events
``KEY/log``    ``foxglove.Log``                                           events
``KEY/image``  ``foxglove.CompressedImage``, format jpeg; png for depth   pictures; its time is that of capture
``KEY/pose``   ``foxglove.PoseInFrame``                                   x y z qw qx qy qz: head, controllers
``KEY/poses``  ``foxglove.PosesInFrame``                                  several of those: the joints of a hand
``KEY/tf``     ``foxglove.FrameTransform`` from ``world`` to ``<key>``    root_x … root_quat_z: ground truth of the root
=============  =========================================================  =============================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from station.bus import codec, keys
from station.bus.robot_streams import ROOT
from station.contract import OPERATOR_FRAME, WORLD_FRAME, Contract, names_of
from station.enrich.scalars import ObjectType, Shape
from station.enrich.vector import VectorType
from station.episode.reading.frames import captured_ns
from station.episode.reading.messages import Message
from station.episode.reading.vectors import decoder
from station.episode.storage import pictures
from station.life import events
from station.protobuf import foxglove
from station.protobuf.schema import Schema

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_ROOT = names_of(ROOT)

TYPED, LOG, IMAGE, POSE_TOPIC, POSES_TOPIC, TRANSFORM = "typed", "log", "image", "pose", "poses", "tf"

Encode = Callable[[Message], list[bytes] | None]


class Siblings(NamedTuple):
    """The typed topics of a key.

    Attributes:
        topics: Name and schema of each.
        encode: Returns the bytes of a message for each of them; None where the value does not fit its contract.
    """

    topics: list[tuple[str, Schema]]
    encode: Encode


def siblings(contract: Contract, shape: Shape, name: str) -> Siblings | str:
    """Return the typed topics of a key; or, where it gets none, why.

    Args:
        contract: As it was recorded with the key.
        shape: What its values hold, when they are JSON objects.
        name: Full name for a message type of its own.
    """
    try:
        if contract.codec in pictures.FORMATS:
            return _picture(contract)
        if contract.key == keys.EVENT:
            return _event(contract)
        if contract.codec == "json":
            return _object(contract, shape, name)
        if not contract.elements or contract.codec == "text":
            return "its contract names no elements"
        return _vector(contract, name)
    except ValueError as error:
        return str(error)


def _picture(contract: Contract) -> Siblings:
    camera, form = pictures.camera_of(contract.key), contract.codec

    def encode(message: Message) -> list[bytes]:
        return [pictures.compressed_image(message.data, captured_ns(message), camera, form)]

    return Siblings([(f"{contract.key}/{IMAGE}", foxglove.schema(foxglove.COMPRESSED_IMAGE))], encode)


def _event(contract: Contract) -> Siblings:
    def encode(message: Message) -> list[bytes] | None:
        event = events.decode(message.data)
        return None if event is None else [foxglove.log(event, message.publish_ns)]

    return Siblings([(f"{contract.key}/{LOG}", foxglove.schema(foxglove.LOG))], encode)


def _object(contract: Contract, shape: Shape, name: str) -> Siblings | str:
    if not shape.fields:
        return "its values hold no scalar that keeps its type"
    made = ObjectType(name, shape, contract.note)

    def encode(message: Message) -> list[bytes] | None:
        try:
            data = made.encode(codec.parse_json(message.data))
        except codec.BadValue:
            return None
        return None if data is None else [data]

    return Siblings([(f"{contract.key}/{TYPED}", made.schema)], encode)


def _vector(contract: Contract, name: str) -> Siblings:
    made = VectorType(name, contract.elements, contract.note)
    decode, length = decoder(contract.codec), len(contract.elements)
    topics, others = [(f"{contract.key}/{TYPED}", made.schema)], _drawn(contract)
    topics += [(f"{contract.key}/{topic}", foxglove.schema(schema)) for topic, schema, _ in others]

    def encode(message: Message) -> list[bytes] | None:
        values = decode(message.data)
        if values is None or len(values) != length:
            return None
        values = values.tolist() if isinstance(values, np.ndarray) else values
        return [made.encode(values), *(draw(values, message.publish_ns) for _, _, draw in others)]

    return Siblings(topics, encode)


Draw = Callable[[Sequence[float], int], bytes]


def _drawn(contract: Contract) -> list[tuple[str, str, Draw]]:
    """Return what else a viewer can draw of a vector: topic, message type, and how it is made of values and time."""
    names = contract.names
    if names == POSE:
        return [(POSE_TOPIC, foxglove.POSE_IN_FRAME, lambda row, ns: foxglove.pose(row, ns, OPERATOR_FRAME))]
    if names and len(names) % len(POSE) == 0 and names == _poses(names):
        return [(POSES_TOPIC, foxglove.POSES_IN_FRAME, lambda row, ns: foxglove.poses(row, ns, OPERATOR_FRAME))]
    if set(_ROOT) <= set(names):
        places = [names.index(name) for name in _ROOT]

        def draw(row: Sequence[float], time_ns: int) -> bytes:
            return foxglove.transform([row[place] for place in places], time_ns, WORLD_FRAME, contract.key)

        return [(TRANSFORM, foxglove.FRAME_TRANSFORM, draw)]
    return []


def _poses(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names that as many elements would have if they were poses of joints."""
    joints = [name.removesuffix("_x") for name in names[:: len(POSE)]]
    return tuple(f"{joint}_{axis}" for joint in joints for axis in POSE)
