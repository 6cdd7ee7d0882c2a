"""A Livox lidar's own datagrams: points and its IMU, as a MID-360 sends them to one host.

Source: ``livox_lidar_def.h`` of Livox-SDK/Livox-SDK2. Checksums are not looked at: the SDK does not either.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from adapters.lidars.room import FIELDS, FRAME, STRIDE
from station.point_cloud import BadCloud, PointCloud, SensorPose, records

_HEAD = struct.Struct("<BHHHHBBB12xIQ")  # version, length, interval, points, count, frame, type, clock, crc, time
_IMU = struct.Struct("<6f")
IMU, MILLIMETRES, CENTIMETRES = 0, 1, 2
"""Types of data."""

_POINTS = {
    MILLIMETRES: (np.dtype([("xyz", "<i4", 3), ("intensity", "u1"), ("tag", "u1")]), 1e-3),
    CENTIMETRES: (np.dtype([("xyz", "<i2", 3), ("intensity", "u1"), ("tag", "u1")]), 1e-2),
}
_IN_A_PACKET, _LINES = 96, 4
_TENTH_OF_A_MICROSECOND = 100  # ns
_DTYPE = np.dtype({
    "names": [field.name for field in FIELDS], "formats": [field.type for field in FIELDS],
    "offsets": [field.offset for field in FIELDS], "itemsize": STRIDE,
})  # fmt: skip


class Packet(NamedTuple):
    """A datagram.

    Attributes:
        number: Of those of its kind, from 0 again with each frame.
        type: `IMU`, `MILLIMETRES` or `CENTIMETRES`.
        points: How many it holds.
        interval_ns: From point to point [ns].
        sensor_ns: Of its first point, by the sensor's clock [ns].
        payload: Behind the head.
    """

    number: int
    type: int
    points: int
    interval_ns: float
    sensor_ns: int
    payload: bytes


def parse(data: bytes) -> Packet:
    """Return the packet of a datagram.

    Raises:
        BadCloud: it is none; one line.
    """
    if len(data) < _HEAD.size:
        raise BadCloud(f"a packet of {len(data)} bytes; expected {_HEAD.size} or more")
    _, length, interval, points, count, _, kind, _, _, sensor_ns = _HEAD.unpack_from(data)
    if length != len(data):
        raise BadCloud(f"a packet of {len(data)} bytes says that it has {length}")
    size = _IMU.size if kind == IMU else points * _POINTS[kind][0].itemsize if kind in _POINTS else -1
    if size < 0:
        raise BadCloud(f"data of type {kind}; expected 0 to 2: set the lidar to Cartesian coordinates")
    if length != _HEAD.size + size or not (points or kind == IMU):
        raise BadCloud(f"a packet of {length} bytes with {points} points of type {kind}")
    spacing = interval * _TENTH_OF_A_MICROSECOND / max(1, points)
    return Packet(count, kind, points, spacing, sensor_ns, data[_HEAD.size :])


def imu_of(packet: Packet) -> tuple[float, ...]:
    """Return angular velocity [rad/s] and acceleration [g] of a packet of the IMU, six finite numbers.

    Raises:
        BadCloud: it is of another type, or not finite.
    """
    values = _IMU.unpack(packet.payload) if packet.type == IMU else ()
    if not values or not np.isfinite(values).all():
        raise BadCloud("a packet without a sample of the IMU")
    return tuple(values)


def cloud_of(packets: Sequence[Packet]) -> PointCloud:
    """Return the cloud of the packets of a frame, in the layout of Livox's ROS driver: metres, and a time per point."""
    data = b"".join(_rows(kind, list(alike)) for kind, alike in groupby(packets, lambda packet: packet.type))
    last = packets[-1] if packets else None
    end_ns = None if last is None else last.sensor_ns + round((last.points - 1) * last.interval_ns)
    return PointCloud(FRAME, SensorPose(), STRIDE, FIELDS, data, end_ns)


def _rows(kind: int, packets: Sequence[Packet]) -> bytes:
    """Return the records of the points of packets of one type."""
    layout, unit_m = _POINTS[kind]
    points = np.frombuffer(b"".join([packet.payload for packet in packets]), layout)
    counts = [packet.points for packet in packets]
    # How many points lie before each one in its packet: all that came before, less those of earlier packets.
    place = np.arange(len(points)) - np.repeat(np.cumsum([0, *counts[:-1]]), counts)
    rows = np.zeros(len(points), _DTYPE)
    for column, axis in enumerate("xyz"):
        rows[axis] = points["xyz"][:, column] * np.float32(unit_m)
    rows["intensity"], rows["tag"], rows["line"] = points["intensity"], points["tag"], place % _LINES
    starts, spacings = [packet.sensor_ns for packet in packets], [packet.interval_ns for packet in packets]
    rows["timestamp"] = np.repeat(np.array(starts, np.float64), counts) + place * np.repeat(spacings, counts)
    return rows.tobytes()


def write_points(cloud: PointCloud, *, kind: int = MILLIMETRES) -> Iterator[bytes]:
    """Yield the packets of a cloud of a room, as a lidar sends it."""
    rows, (layout, unit_m) = records(cloud), _POINTS[kind]
    for count, start in enumerate(range(0, len(rows), _IN_A_PACKET)):
        part = rows[start : start + _IN_A_PACKET]
        points = np.zeros(len(part), layout)
        for column, axis in enumerate("xyz"):
            points["xyz"][:, column] = np.rint(part[axis] / unit_m)
        points["intensity"], points["tag"] = part["intensity"].astype(np.uint8), part["tag"]
        spacing_ns = float(np.diff(part["timestamp"]).mean()) if len(part) > 1 else 0.0
        interval = round(spacing_ns * len(part) / _TENTH_OF_A_MICROSECOND)
        yield _written(points.tobytes(), kind, len(part), interval, count, int(part["timestamp"][0]))


def write_imu(values: Sequence[float], count: int, sensor_ns: int) -> bytes:
    """Return the packet of a sample of the IMU: angular velocity [rad/s] and acceleration [g]."""
    return _written(_IMU.pack(*values), IMU, 1, 0, count, sensor_ns)


def _written(payload: bytes, kind: int, points: int, interval: int, count: int, sensor_ns: int) -> bytes:
    length = _HEAD.size + len(payload)
    return _HEAD.pack(0, length, interval, points, count % (1 << 16), 0, kind, 0, 0, sensor_ns) + payload
