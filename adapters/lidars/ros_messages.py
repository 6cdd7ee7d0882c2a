"""ROS 2's messages of a lidar as bytes on the wire: PointCloud2 and Imu in CDR, their points never touched one by one.

The table of fields, the byte order and the padding are read from each message and never assumed.
Source: ``sensor_msgs`` of ros2/common_interfaces; CDR as in OMG's DDS-XTypes 1.3, 7.4.1 (XCDR1).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from adapters.ros2.cdr import Cursor
from station.point_cloud import TYPES, BadCloud, PointCloud, PointField, SensorPose, expect_sound

_TYPES = ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")  # of PointField, from 1
_NUMBERS = {name: number for number, name in enumerate(_TYPES, 1)}
_HEAD_BYTES = 4  # of any message: how the rest is written
_LITTLE, _BIG = b"\x00\x01", b"\x00\x00"
_MOST_FIELDS = 64
_ORDERS = {_LITTLE: "<", _BIG: ">"}
_COVARIANCE = 9
_IMU_HEADS = {order: struct.Struct(f"{order}iII") for order in "<>"}  # stamp, length of the frame's name
_IMU_BODIES = {order: struct.Struct(f"{order}37d") for order in "<>"}
_IMU_HEAD_BYTES = _HEAD_BYTES + 12
_GYRO = 4 + _COVARIANCE  # behind an orientation
_ACCELERATION = _GYRO + 3 + _COVARIANCE
_NANOSECONDS = 1_000_000_000


class Imu(NamedTuple):
    """A sample of an IMU in the sensor's frame.

    Attributes:
        gyro: Angular velocity [rad/s].
        acceleration: As sent.
        sensor_ns: When it was measured, by the sensor's own clock [ns].
    """

    gyro: tuple[float, float, float]
    acceleration: tuple[float, float, float]
    sensor_ns: int


def parse_cloud(data: bytes) -> PointCloud:
    """Return the cloud of a PointCloud2; its points are those of the message, not copied where they may stay.

    They are copied where rows are padded or numbers big-endian.

    Raises:
        BadCloud: it is none, truncated, or does not hold together; one line.
    """
    at = Cursor(data, BadCloud)
    stamp_ns, frame = at.header()
    height, width = at.number("I"), at.number("I")
    fields = _fields(at)
    is_big = bool(at.number("B"))
    stride, row = at.number("I"), at.number("I")
    size = at.number("I")
    points = at.take(size)
    at.number("B")  # whether all points are finite; each is looked at anyway
    if row < width * stride:
        raise BadCloud(f"row_step is {row}; {width} points of {stride} bytes need {width * stride}")
    if size < row * height:
        raise BadCloud(f"truncated: {height} rows of {row} bytes are told of, {size} bytes came")
    dense = points[: row * height] if row == width * stride else _dense(points, height, row, width * stride)
    cloud = PointCloud(frame, SensorPose(), stride, fields, dense, stamp_ns)
    expect_sound(cloud)
    return cloud._replace(data=_little(cloud)) if is_big else cloud


def write_cloud(cloud: PointCloud, *, is_big: bool = False, width: int | None = None, padding: int = 0) -> bytes:
    """Return the PointCloud2 of a cloud, as a sensor's driver writes it.

    Args:
        cloud: Its points are written as they are.
        is_big: What the message says of the order of their bytes.
        width: Points in a row; None for all in one.
        padding: Bytes behind each row.
    """
    width = cloud.points if width is None else width
    height = cloud.points // width if width else 1
    data = bytes(cloud.data)
    if padding:
        rows = np.frombuffer(data, np.uint8).reshape(height, width * cloud.stride)
        data = np.pad(rows, ((0, 0), (0, padding))).tobytes()
    out = bytearray(_header(cloud.sensor_ns or 0, cloud.frame))
    _add(out, "II", height, width)
    _add(out, "I", len(cloud.fields))
    for field in cloud.fields:
        _add_text(out, field.name)
        _add(out, "I", field.offset)
        _add(out, "B", _NUMBERS[field.type])
        _add(out, "I", 1)
    _add(out, "B", is_big)
    _add(out, "III", cloud.stride, width * cloud.stride + padding, len(data))
    return b"\x00\x01\x00\x00" + bytes(out) + data + b"\x01"


def parse_imu(data: bytes) -> Imu:
    """Return the sample of an Imu; its orientation, which a lidar's IMU does not know, is passed over.

    Raises:
        BadCloud: it is none, or truncated; one line.
    """
    order = _ORDERS.get(bytes(data[:2]))
    if order is None or len(data) < _IMU_HEAD_BYTES:
        raise BadCloud(f"a message of {len(data)} bytes that does not begin as XCDR1 does")
    head, body = _IMU_HEADS[order], _IMU_BODIES[order]
    seconds, nanos, frame_bytes = head.unpack_from(data, _HEAD_BYTES)
    end = _IMU_HEAD_BYTES - _HEAD_BYTES + frame_bytes
    start = _HEAD_BYTES + end + -end % 8
    if start + body.size > len(data):
        raise BadCloud(f"truncated: {start + body.size} bytes are told of, {len(data)} came")
    numbers = body.unpack_from(data, start)
    gx, gy, gz = numbers[_GYRO : _GYRO + 3]
    ax, ay, az = numbers[_ACCELERATION : _ACCELERATION + 3]
    return Imu((gx, gy, gz), (ax, ay, az), seconds * _NANOSECONDS + nanos)


def write_imu(sample: Imu, frame: str) -> bytes:
    """Return the Imu of a sample, as a sensor's driver writes it."""
    out = bytearray(_header(sample.sensor_ns, frame))
    nothing = (0.0,) * _COVARIANCE
    _add(out, "d", *(0.0, 0.0, 0.0, 1.0), *nothing, *sample.gyro, *nothing, *sample.acceleration, *nothing)
    return b"\x00\x01\x00\x00" + bytes(out)


def _fields(at: Cursor) -> tuple[PointField, ...]:
    count = at.number("I")
    if count > _MOST_FIELDS:
        raise BadCloud(f"{count} fields; expected {_MOST_FIELDS} at most")
    found: list[PointField] = []
    for _ in range(count):
        name, offset, kind, several = at.text(), at.number("I"), at.number("B"), at.number("I")
        if not 1 <= kind <= len(_TYPES):
            raise BadCloud(f"field {name[:40]!r} is of type {kind}; expected 1 to {len(_TYPES)}")
        if several > _MOST_FIELDS - len(found):
            raise BadCloud(f"field {name[:40]!r} has {several} numbers; expected {_MOST_FIELDS} fields at most")
        form = _TYPES[kind - 1]
        size = np.dtype(form).itemsize
        names = [name] if several <= 1 else [f"{name}_{number}" for number in range(several)]
        found += [PointField(one, offset + number * size, form) for number, one in enumerate(names)]
    return tuple(found)


def _dense(points: memoryview, height: int, row: int, used: int) -> bytes:
    """Return rows without what is behind the points of each."""
    return np.frombuffer(points[: row * height], np.uint8).reshape(height, row)[:, :used].tobytes()


def _little(cloud: PointCloud) -> bytes:
    """Return points whose fields were big-endian; bytes that no field tells of stay as they are."""
    rows = np.frombuffer(cloud.data, np.uint8).reshape(cloud.points, cloud.stride).copy()
    for field in cloud.fields:
        end = field.offset + np.dtype(field.type).itemsize
        rows[:, field.offset : end] = rows[:, field.offset : end][:, ::-1].copy()
    return rows.tobytes()


def _header(stamp_ns: int, frame: str) -> bytes:
    out = bytearray()
    _add(out, "iI", *divmod(stamp_ns, _NANOSECONDS))
    _add_text(out, frame)
    return bytes(out)


def _add(out: bytearray, codes: str, *values: float) -> None:
    """Add numbers, each at a multiple of its size; the last code is that of all that follow."""
    for index, value in enumerate(values):
        code = codes[min(index, len(codes) - 1)]
        out += bytes(-len(out) % struct.calcsize(code)) + struct.pack(f"<{code}", value)


def _add_text(out: bytearray, text: str) -> None:
    data = text.encode() + b"\0"
    _add(out, "I", len(data))
    out += data


assert set(_TYPES) == set(TYPES)
