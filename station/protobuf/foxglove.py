"""The message types of Foxglove that viewers draw, and how ours become them.

Names, numbers and types of the fields are those that Foxglove publishes (``foxglove-sdk``, ``schemas/proto``); fields
that we never fill are left out, which is what protobuf allows. Quaternions: ours are ``w x y z``, theirs have names.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from station.life.events import Event, Severity
from station.optics import Intrinsics
from station.protobuf import schema as types
from station.protobuf.schema import TIMESTAMP, Field, Schema

_NANOSECONDS = 1_000_000_000
_VECTOR3, _QUATERNION, _POSE = "foxglove.Vector3", "foxglove.Quaternion", "foxglove.Pose"

CAMERA_CALIBRATION = "foxglove.CameraCalibration"
COMPRESSED_IMAGE = "foxglove.CompressedImage"
COMPRESSED_VIDEO = "foxglove.CompressedVideo"
FRAME_TRANSFORM = "foxglove.FrameTransform"
LOG = "foxglove.Log"
PACKED_ELEMENT_FIELD = "foxglove.PackedElementField"
POINT_CLOUD = "foxglove.PointCloud"
POSE_IN_FRAME = "foxglove.PoseInFrame"
POSES_IN_FRAME = "foxglove.PosesInFrame"

_TYPES: dict[str, tuple[Field, ...]] = {
    _VECTOR3: (Field("x", 1, "double"), Field("y", 2, "double"), Field("z", 3, "double")),
    _QUATERNION: tuple(Field(axis, number, "double") for number, axis in enumerate("xyzw", 1)),
    _POSE: (Field("position", 1, _VECTOR3), Field("orientation", 2, _QUATERNION)),
    POSE_IN_FRAME: (Field("timestamp", 1, TIMESTAMP), Field("frame_id", 2, "string"), Field("pose", 3, _POSE)),
    POSES_IN_FRAME: (
        Field("timestamp", 1, TIMESTAMP), Field("frame_id", 2, "string"), Field("poses", 3, _POSE, is_repeated=True),
    ),
    FRAME_TRANSFORM: (
        Field("timestamp", 1, TIMESTAMP), Field("parent_frame_id", 2, "string"), Field("child_frame_id", 3, "string"),
        Field("translation", 4, _VECTOR3), Field("rotation", 5, _QUATERNION),
    ),
    CAMERA_CALIBRATION: (
        Field("timestamp", 1, TIMESTAMP), Field("frame_id", 9, "string"), Field("width", 2, "fixed32"),
        Field("height", 3, "fixed32"), Field("distortion_model", 4, "string"),
        *(Field(name, number, "double", is_repeated=True) for number, name in enumerate("DKRP", 5)),
    ),
    COMPRESSED_IMAGE: (
        Field("timestamp", 1, TIMESTAMP), Field("data", 2, "bytes"), Field("format", 3, "string"),
        Field("frame_id", 4, "string"),
    ),
    COMPRESSED_VIDEO: (
        Field("timestamp", 1, TIMESTAMP), Field("frame_id", 2, "string"), Field("data", 3, "bytes"),
        Field("format", 4, "string"), Field("message_id", 100, "string"),
    ),
    PACKED_ELEMENT_FIELD: (
        Field("name", 1, "string"), Field("offset", 2, "fixed32"),
        Field("type", 3, f"enum:{PACKED_ELEMENT_FIELD}.NumericType"),
    ),
    POINT_CLOUD: (
        Field("timestamp", 1, TIMESTAMP), Field("frame_id", 2, "string"), Field("pose", 3, _POSE),
        Field("point_stride", 4, "fixed32"), Field("fields", 5, PACKED_ELEMENT_FIELD, is_repeated=True),
        Field("data", 6, "bytes"), Field("sensor_time", 100, TIMESTAMP, "ours: the sensor's own clock"),
    ),
    LOG: (
        Field("timestamp", 1, TIMESTAMP), Field("level", 2, "enum:foxglove.Log.Level"), Field("message", 3, "string"),
        Field("name", 4, "string"), Field("file", 5, "string"), Field("line", 6, "fixed32"),
    ),
}  # fmt: skip
_ENUMS: dict[str, list[tuple[str, tuple[str, ...]]]] = {
    LOG: [("Level", ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"))],
    PACKED_ELEMENT_FIELD: [
        ("NumericType", ("UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"))
    ],
}
_LEVELS: dict[Severity, int] = {"info": 2, "warning": 3, "error": 4}


@cache
def schema(name: str) -> Schema:
    """Return the schema of one of the types above."""
    order: list[str] = []
    _visit(name, order)
    files = [
        types.timestamp_file() if used == TIMESTAMP else
        types.message_file(used, _TYPES[used], enums=_ENUMS.get(used, ()))
        for used in order
    ]  # fmt: skip
    return Schema(name, types.file_set(files))


def log(event: Event, time_ns: int) -> bytes:
    """Return an event as a line of a log; time in [ns since the epoch]."""
    message = _stamped(LOG, time_ns)
    message.level, message.message, message.name = _LEVELS[event.severity], str(event), event.source
    return bytes(message.SerializeToString())


def pose(values: Sequence[float], time_ns: int, frame: str) -> bytes:
    """Return a pose: x y z [m] qw qx qy qz in a frame."""
    message = _stamped(POSE_IN_FRAME, time_ns)
    message.frame_id = frame
    _place(message.pose.position, message.pose.orientation, values)
    return bytes(message.SerializeToString())


def poses(values: Sequence[float], time_ns: int, frame: str) -> bytes:
    """Return several poses, seven numbers each as in `pose`."""
    message = _stamped(POSES_IN_FRAME, time_ns)
    message.frame_id = frame
    for start in range(0, len(values), 7):
        added = message.poses.add()
        _place(added.position, added.orientation, values[start : start + 7])
    return bytes(message.SerializeToString())


def transform(values: Sequence[float], time_ns: int, parent: str, child: str) -> bytes:
    """Return where a child frame stands in its parent: seven numbers as in `pose`."""
    message = _stamped(FRAME_TRANSFORM, time_ns)
    message.parent_frame_id, message.child_frame_id = parent, child
    _place(message.translation, message.rotation, values)
    return bytes(message.SerializeToString())


def camera_calibration(inner: Intrinsics, time_ns: int, frame: str) -> bytes:
    """Return the optics of a single camera, whose frame has x to the right in the picture, y down, z forward.

    Without distortion the model is plumb_bob with zeros: readers know no name for none.
    """
    message = _stamped(CAMERA_CALIBRATION, time_ns)
    message.frame_id, message.width, message.height = frame, inner.width, inner.height
    message.distortion_model, coefficients = inner.lens
    message.D.extend(coefficients)
    message.K.extend(inner.matrix)
    message.R.extend([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    message.P.extend(inner.projection)
    return bytes(message.SerializeToString())


def _visit(name: str, order: list[str]) -> None:
    """Add a type to the order of files, behind the types that it is made of."""
    for field in _TYPES.get(name, ()):
        if field.type == TIMESTAMP or field.type in _TYPES:
            _visit(field.type, order)
    if name not in order:
        order.append(name)


@cache
def _class(name: str) -> Any:
    return types.message_class(schema(name))


def _stamped(name: str, time_ns: int) -> Any:
    message = _class(name)()
    message.timestamp.seconds, message.timestamp.nanos = divmod(time_ns, _NANOSECONDS)
    return message


def _place(position: Any, orientation: Any, values: Sequence[float]) -> None:
    position.x, position.y, position.z = values[:3]
    orientation.w, orientation.x, orientation.y, orientation.z = values[3:]
