"""How values of ours become ROS messages: numbers, pictures, clouds, events. Stamps are nanoseconds since the epoch.

Quaternions of the station are w x y z, those of ROS x y z w; units are SI on both sides, axes those of REP-103.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adapters.exports.ros2.ros_types import cdr, header, make
from station import depth, point_cloud
from station.bus import codec
from station.optics import Intrinsics

JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
TWIST = "geometry_msgs/msg/TwistStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGE = "sensor_msgs/msg/Image"
CLOUD = "sensor_msgs/msg/PointCloud2"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
NUMBERS = "std_msgs/msg/Float64MultiArray"
INTEGER = "std_msgs/msg/Int64"
TEXT = "std_msgs/msg/String"

LEVELS = {"info": 0, "warning": 1, "error": 2}  # OK, WARN, ERROR of DiagnosticStatus
_FIELD_TYPES = {"i1": 1, "u1": 2, "<i2": 3, "<u2": 4, "<i4": 5, "<u4": 6, "<f4": 7, "<f8": 8}  # of PointField
_UNCOMPRESSED_STEPS = struct.pack("<iff", 0, 0.0, 0.0)
"""Stands before the PNG file of a ``compressedDepth``; its parameters are for depth that was not whole steps."""

_UNKNOWN, _NOT_MEASURED = (0.0,) * 9, (-1.0, *(0.0,) * 8)
"""Covariances: zeros where nothing says how good a measurement is, -1 first where there is none (sensor_msgs/Imu)."""

_NO_ROTATION = (1.0, 0.0, 0.0, 0.0)
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_IMU = struct.Struct("<37d")  # of some hundred a second: laid out here, ten times as fast as field by field
_NANOSECONDS = 1_000_000_000


class NumberArrays:
    """Makes messages of rows of numbers whose columns have names.

    The layout is that of a table of rows and columns; behind these two, a dimension of size 1 per column bears its
    name, so that the labels are all there and the sizes still multiply to the count of the numbers. All that does not
    change is made once for each number of rows.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._heads: dict[tuple[int, int], bytes] = {}

    def encode(self, table: NDArray[np.float64]) -> bytes:
        """Return numbers, shape (rows, columns); one vector is a table of one row."""
        if table.shape not in self._heads:
            rows, columns = table.shape
            sizes = [("rows", rows), ("columns", columns), *((name, 1) for name in self._names)]
            strides = [rows * columns, columns, *[1] * len(self._names)]
            dimensions = [
                make("std_msgs/msg/MultiArrayDimension", label, size, stride)
                for (label, size), stride in zip(sizes, strides, strict=True)
            ]
            layout = make("std_msgs/msg/MultiArrayLayout", dimensions, 0)
            whole = cdr(make(NUMBERS, layout, np.zeros(table.size)))
            self._heads[rows, columns] = whole[: len(whole) - table.nbytes]
        return self._heads[table.shape] + table.astype("<f8", copy=False).tobytes()


def imu(
    stamp_ns: int, frame: str, quat_wxyz: Sequence[float] | None, gyro: Sequence[float], acc: Sequence[float] | None
) -> bytes:
    """Return a sample of an IMU: orientation, angular velocity [rad/s], acceleration [m/s^2]; None for not measured."""
    w, x, y, z = quat_wxyz or _NO_ROTATION
    return _framed(stamp_ns, frame) + _IMU.pack(
        x, y, z, w, *(_NOT_MEASURED if quat_wxyz is None else _UNKNOWN),
        *gyro, *_UNKNOWN,
        *(acc or (0.0, 0.0, 0.0)), *(_NOT_MEASURED if acc is None else _UNKNOWN),
    )  # fmt: skip


def twist(stamp_ns: int, frame: str, linear: Sequence[float], angular: Sequence[float]) -> bytes:
    """Return a velocity: linear [m/s] and angular [rad/s]."""
    return cdr(make(TWIST, header(stamp_ns, frame), make("geometry_msgs/msg/Twist", _vector(linear), _vector(angular))))


def pose(stamp_ns: int, frame: str, values: Sequence[float]) -> bytes:
    """Return a pose in a frame: x y z [m] qw qx qy qz."""
    place = make("geometry_msgs/msg/Point", *map(float, values[:3]))
    return cdr(make(POSE, header(stamp_ns, frame), make("geometry_msgs/msg/Pose", place, _quaternion(values[3:]))))


def transform(stamp_ns: int, parent: str, child: str, values: Sequence[float]) -> bytes:
    """Return where a child frame stands in its parent: seven numbers as in `pose`."""
    found = make("geometry_msgs/msg/Transform", _vector(values[:3]), _quaternion(values[3:]))
    return cdr(make(TRANSFORMS, [make("geometry_msgs/msg/TransformStamped", header(stamp_ns, parent), child, found)]))


def jpeg(stamp_ns: int, frame: str, data: bytes) -> bytes:
    """Return a picture, its file byte for byte."""
    return _compressed(stamp_ns, frame, "jpeg", data)


def depth_in_millimetres(stamp_ns: int, frame: str, data: bytes) -> bytes:
    """Return depth in steps of 1 mm, its PNG file byte for byte, as ``compressed_depth_image_transport`` has it."""
    return _compressed(stamp_ns, frame, "16UC1; compressedDepth png", _UNCOMPRESSED_STEPS + data)


def depth_in_metres(stamp_ns: int, frame: str, steps: depth.Steps, step_m: float) -> bytes:
    """Return depth of another step as float32 in metres, for ROS knows no other one.

    REP-118: 16 bits are millimetres, 32 bits metres; without a measurement a pixel is NaN there.
    """
    metres = depth.in_metres(steps, step_m)
    metres[steps == 0] = np.nan
    height, width = metres.shape
    raw = np.frombuffer(metres.astype("<f4").tobytes(), np.uint8)
    return cdr(make(IMAGE, header(stamp_ns, frame), height, width, "32FC1", 0, 4 * width, raw))


def camera_info(stamp_ns: int, frame: str, inner: Intrinsics) -> bytes:
    """Return the optics of a single camera, as they are for the picture of that instant."""
    model, coefficients = inner.lens
    whole = make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    matrices = (inner.matrix, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), inner.projection)
    numbers = (np.array(each, np.float64) for each in (coefficients, *matrices))
    return cdr(make(CAMERA_INFO, header(stamp_ns, frame), inner.height, inner.width, model, *numbers, 0, 0, whole))


def cloud(stamp_ns: int, frame: str, found: point_cloud.PointCloud) -> bytes:
    """Return a cloud in its sensor's own frame: every field of every point as it was recorded, in one row."""
    fields = [
        make("sensor_msgs/msg/PointField", field.name, field.offset, _FIELD_TYPES[field.type], 1)
        for field in found.fields
    ]
    data = np.frombuffer(found.data, np.uint8)
    stride = found.stride
    return cdr(make(CLOUD, header(stamp_ns, frame), 1, found.points, fields, False, stride, len(data), data, False))


def diagnostics(stamp_ns: int, event: Mapping[str, Any]) -> bytes:
    """Return an event of the station, or a mark of its operator, as the status of who says it.

    Args:
        stamp_ns: When it was said.
        event: Members of `station.life.events.Event`, as decoded; a severity is one of `LEVELS`.
    """
    source, name, detail = str(event["source"]), str(event["name"]), event["detail"]
    values = [make("diagnostic_msgs/msg/KeyValue", word, _said(value)) for word, value in detail.items()]
    level = LEVELS[event["severity"]]
    status = make("diagnostic_msgs/msg/DiagnosticStatus", level, f"{source}: {name}", name, source, values)
    return cdr(make(DIAGNOSTICS, header(stamp_ns), [status]))


def text(value: str) -> bytes:
    """Return a text."""
    return cdr(make(TEXT, value))


def integer(value: int) -> bytes:
    """Return a whole number."""
    return cdr(make(INTEGER, value))


def table(values: ArrayLike, columns: int) -> NDArray[np.float64]:
    """Return numbers as a table of so many columns."""
    return np.asarray(values, np.float64).reshape(-1, columns) if columns else np.empty((1, 0))


def _framed(stamp_ns: int, frame: str) -> bytes:
    """Return the beginning of a message that has a header, and numbers of 64 bits behind it."""
    name = frame.encode() + b"\0"
    head = _STAMP.pack(*divmod(stamp_ns, _NANOSECONDS)) + struct.pack("<I", len(name)) + name
    return _LITTLE_ENDIAN + head + bytes(-len(head) % 8)


def _said(value: Any) -> str:
    return value if isinstance(value, str) else codec.json_object(value).decode()


def _compressed(stamp_ns: int, frame: str, form: str, data: bytes) -> bytes:
    return cdr(make(COMPRESSED, header(stamp_ns, frame), form, np.frombuffer(data, np.uint8)))


def _vector(values: Sequence[float]) -> Any:
    return make("geometry_msgs/msg/Vector3", *map(float, values))


def _quaternion(wxyz: Sequence[float]) -> Any:
    w, x, y, z = map(float, wxyz)
    return make("geometry_msgs/msg/Quaternion", x, y, z, w)
