"""A point cloud as bytes: a ``foxglove.PointCloud`` without its time, around the points as the sensor gave them.

Whatever the sensor measures stays in it: each point is a record of so many bytes, and a table says which field begins
where. The table travels with each cloud, so no reader assumes one. The recorder puts the time before it.

What stands around the points is made by hand, since the library would copy them; numbers of fields are those of
`station.protobuf.foxglove`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from station import rotations
from station.protobuf import wire
from station.protobuf.wire import BYTES, FIXED32, FIXED64, VARINT, varint
from station.protocols import Floats32

MOST_POINTS = 50_000
"""Points that a reader gets unless it asks for another number."""
VOXEL_M = 0.05

FARTHEST_M = 10_000.0
"""A coordinate beyond that is none; voxels can be counted up to there."""

TYPES = {"u1": 1, "i1": 2, "<u2": 3, "<i2": 4, "<u4": 5, "<i4": 6, "<f4": 7, "<f8": 8}
"""Number of a field's type in the message, by NumPy's name of it."""

_NAMES = {number: name for name, number in TYPES.items()}
_AXES = ("x", "y", "z")
_MOST_STRIDE, _MOST_FIELDS = 4096, 64
_SMALLEST_VOXEL_M = 0.01
_FIXED, _DOUBLE = struct.Struct("<I"), struct.Struct("<d")
_FRAME, _POSE, _STRIDE, _FIELD, _DATA, _SENSOR_TIME = 2, 3, 4, 5, 6, 100
_NANOSECONDS = 1_000_000_000


class BadCloud(ValueError):
    """Bytes that are no point cloud; one line that says why."""


class PointField(NamedTuple):
    """A field of each point.

    Attributes:
        name: As the sensor calls it; the position is ``x``, ``y``, ``z`` [m].
        offset: Where it begins in the record of a point [bytes].
        type: One of `TYPES`.
    """

    name: str
    offset: int
    type: str


class SensorPose(NamedTuple):
    """Where a sensor is in a frame: position [m], and the rotation that turns its axes into those of the frame."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


class PointCloud(NamedTuple):
    """A cloud.

    Attributes:
        frame: What its pose is in: a body of the robot, ``world``; where it has no mount, the sensor's own frame.
        pose: Of the sensor in that frame.
        stride: Size of a point's record [bytes].
        fields: Of each point.
        data: The records, little-endian, as they came.
        sensor_ns: When it was measured, by the sensor's own clock [ns]; None where that is not known.
    """

    frame: str
    pose: SensorPose
    stride: int
    fields: tuple[PointField, ...]
    data: bytes | memoryview
    sensor_ns: int | None = None

    @property
    def points(self) -> int:
        """How many points it has, returns or not."""
        return len(self.data) // self.stride


def encoded(cloud: PointCloud) -> bytes:
    """Return the bytes of a cloud.

    Raises:
        BadCloud: its fields and its points do not fit each other.
    """
    expect_sound(cloud)
    head = _head(cloud.frame, cloud.pose, cloud.stride, cloud.fields)
    is_timed = cloud.sensor_ns is not None and cloud.sensor_ns >= 0  # a sensor without a clock may tell anything
    time = _member(_SENSOR_TIME, _time(cloud.sensor_ns or 0)) if is_timed else b""
    return b"".join((head, time, _tag(_DATA, BYTES), varint(len(cloud.data)), cloud.data))


def decoded(value: bytes) -> PointCloud:
    """Return the cloud that bytes are; its points are not copied.

    Raises:
        BadCloud: they are none.
    """
    view = memoryview(value)
    frame, pose, stride, sensor_ns, data = "", SensorPose(), 0, None, view[:0]
    fields: list[PointField] = []
    try:
        for number, kind, start, end in wire.fields(view):
            part = view[start:end]
            match number, kind:
                case 2, wire.BYTES:
                    frame = bytes(part).decode()
                case 3, wire.BYTES:
                    pose = _pose_in(part)
                case 4, wire.FIXED32:
                    stride = _FIXED.unpack(part)[0]
                case 5, wire.BYTES if len(fields) < _MOST_FIELDS:
                    fields.append(_field_in(part))
                case 6, wire.BYTES:
                    data = part
                case 100, wire.BYTES:
                    sensor_ns = _time_in(part)
    except BadCloud:
        raise
    except ValueError as error:  # UnicodeDecodeError is one
        raise BadCloud(f"no point cloud: {error}") from None
    found = PointCloud(frame, pose, stride, tuple(fields), data, sensor_ns)
    expect_sound(found)
    return found


def xyz(cloud: PointCloud, *, most: int = MOST_POINTS, seed: int = 0) -> Floats32:
    """Return the positions of a cloud's points in its frame [m], shape (n, 3), float32, all finite.

    Points without a return, which sensors give as zeros, are left out. Of more than `most` a random choice stays, in
    their order, the same for the same seed.
    """
    table = np.frombuffer(cloud.data, dtype=_dtype(cloud.stride, cloud.fields))
    points = np.empty((len(table), 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # of doubles that no float32 holds, and of NaN that signals
        for column, axis in enumerate(_AXES):
            points[:, column] = table[axis]
        is_return = (np.abs(points) < FARTHEST_M).all(axis=1) & (points != 0.0).any(axis=1)
    points = np.asarray(points[is_return])
    if len(points) > most:
        points = points[np.sort(np.random.default_rng(seed).choice(len(points), most, replace=False))]
    if cloud.pose == SensorPose():
        return points
    moved = rotations.rotate(cloud.pose.quat_wxyz, np.eye(3)).astype(np.float32)  # rows: where its axes point
    found = points @ moved + np.asarray(cloud.pose.position_m, np.float32)
    return np.asarray(found, np.float32)


def voxels(points: Floats32, size_m: float = VOXEL_M) -> Floats32:
    """Return the first point of each cube of an edge that holds any, in their order, shape (n, 3).

    Args:
        points: As `xyz` gives them, nearer than `FARTHEST_M`.
        size_m: Length of an edge, 1 cm or more [m].
    """
    if not size_m >= _SMALLEST_VOXEL_M:
        raise ValueError(f"size_m is {size_m:g}; expected {_SMALLEST_VOXEL_M:g} m or more")
    cells = np.floor(np.clip(points, -FARTHEST_M, FARTHEST_M) / size_m).astype(np.int64) + (1 << 20)
    _, first = np.unique(cells[:, 0] << 42 | cells[:, 1] << 21 | cells[:, 2], return_index=True)
    return points[np.sort(first)]


def records(cloud: PointCloud) -> NDArray[np.void]:
    """Return the points with all fields, by name, as they came; not copied."""
    named = [(field.name, field.type, field.offset) for field in cloud.fields]
    names, types, offsets = zip(*named, strict=True)
    layout = np.dtype({
        "names": list(names), "formats": list(types), "offsets": list(offsets), "itemsize": cloud.stride,
    })  # fmt: skip
    return np.frombuffer(cloud.data, dtype=layout)


def expect_sound(cloud: PointCloud) -> None:
    """Refuse a cloud whose fields and points do not fit each other.

    Raises:
        BadCloud: they do not; one line.
    """
    _expect_layout(cloud.stride, cloud.fields)
    if len(cloud.data) % cloud.stride:
        raise BadCloud(f"{len(cloud.data)} bytes are no whole number of points of {cloud.stride} bytes")


def _expect_layout(stride: int, fields: Sequence[PointField]) -> None:
    if not 1 <= stride <= _MOST_STRIDE:
        raise BadCloud(f"points of {stride} bytes; expected 1 to {_MOST_STRIDE}")
    if lacking := [axis for axis in _AXES if axis not in {field.name for field in fields}]:
        raise BadCloud(f"no field {', '.join(lacking)}; it has {', '.join(field.name for field in fields) or 'none'}")
    if len({field.name for field in fields}) != len(fields):
        raise BadCloud("two fields have the same name")
    for field in fields:
        size = np.dtype(field.type).itemsize
        if field.offset < 0 or field.offset + size > stride:
            raise BadCloud(f"field {field.name} ends at byte {field.offset + size} of points of {stride} bytes")


@lru_cache(maxsize=64)
def _head(frame: str, pose: SensorPose, stride: int, fields: tuple[PointField, ...]) -> bytes:
    parts = [_member(_FRAME, frame.encode())]
    if pose != SensorPose():
        parts.append(_member(_POSE, _pose_bytes(pose)))
    parts += [_tag(_STRIDE, FIXED32), _FIXED.pack(stride)]
    for field in fields:
        told = [_member(1, field.name.encode()), _tag(2, FIXED32), _FIXED.pack(field.offset), _tag(3, VARINT)]
        parts.append(_member(_FIELD, b"".join((*told, varint(TYPES[field.type])))))
    return b"".join(parts)


@lru_cache(maxsize=64)
def _dtype(stride: int, fields: tuple[PointField, ...]) -> np.dtype[np.void]:
    by_name = {field.name: field for field in fields}
    named = [by_name[axis] for axis in _AXES]
    return np.dtype({
        "names": list(_AXES), "formats": [field.type for field in named],
        "offsets": [field.offset for field in named], "itemsize": stride,
    })  # fmt: skip


def _pose_bytes(pose: SensorPose) -> bytes:
    w, x, y, z = pose.quat_wxyz
    place, turn = _doubles(pose.position_m), _doubles((x, y, z, w))
    return _member(1, place) + _member(2, turn)


def _doubles(values: Sequence[float]) -> bytes:
    return b"".join(_tag(number, FIXED64) + _DOUBLE.pack(value) for number, value in enumerate(values, 1))


def _pose_in(part: memoryview) -> SensorPose:
    found = {1: [0.0, 0.0, 0.0], 2: [0.0, 0.0, 0.0, 0.0]}
    for number, kind, start, end in wire.fields(part):
        if kind != BYTES or number not in found:
            continue
        inner = part[start:end]
        for axis, axis_kind, begin, stop in wire.fields(inner):
            if axis_kind == FIXED64 and 1 <= axis <= len(found[number]):
                found[number][axis - 1] = _DOUBLE.unpack(inner[begin:stop])[0]
    (px, py, pz), (x, y, z, w) = found[1], found[2]
    if not (all(abs(one) < FARTHEST_M for one in (px, py, pz)) and abs(math.hypot(w, x, y, z) - 1.0) < 1e-3):
        raise BadCloud("its pose is no position within 10 km and a rotation")
    return SensorPose((px, py, pz), (w, x, y, z))


def _field_in(part: memoryview) -> PointField:
    name, offset, type_number = "", 0, 0
    for number, kind, start, end in wire.fields(part):
        if (number, kind) == (1, BYTES):
            name = bytes(part[start:end]).decode()
        elif (number, kind) == (2, FIXED32):
            offset = _FIXED.unpack(part[start:end])[0]
        elif (number, kind) == (3, VARINT):
            type_number = wire.number_at(part, start)
    if type_number not in _NAMES:
        raise BadCloud(f"field {name[:40]} is of type {type_number}; expected 1 to {len(_NAMES)}")
    return PointField(name, offset, _NAMES[type_number])


def _time(value_ns: int) -> bytes:
    seconds, nanos = divmod(value_ns, _NANOSECONDS)
    return _tag(1, VARINT) + varint(seconds) + _tag(2, VARINT) + varint(nanos)


def _time_in(part: memoryview) -> int:
    found = {1: 0, 2: 0}
    for number, kind, start, _ in wire.fields(part):
        if kind == VARINT and number in found:
            found[number] = wire.number_at(part, start)
    return found[1] * _NANOSECONDS + found[2]


def _tag(number: int, kind: int) -> bytes:
    return varint(number << 3 | kind)


def _member(number: int, value: bytes) -> bytes:
    return _tag(number, BYTES) + varint(len(value)) + value
