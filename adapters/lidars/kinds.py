"""The kinds of lidars as they are registered: by name, with options; libraries are imported when one is opened."""

from __future__ import annotations

from adapters.lidars.options import DdsOptions, RaysOptions, UdpOptions
from station.lidar.source import Lidar, LidarKind


def _dds(options: DdsOptions) -> Lidar:
    from adapters.lidars.dds_lidar import DdsLidar

    return DdsLidar(options)


def _rays(options: RaysOptions) -> Lidar:
    from adapters.lidars.rays import RaysLidar

    return RaysLidar(options)


def _udp(options: UdpOptions) -> Lidar:
    from adapters.lidars.udp_lidar import UdpLidar

    return UdpLidar(options)


DDS = LidarKind(
    name="dds", about="a robot's lidar over DDS: PointCloud2, and its IMU", library="cyclonedds", extra="g1",
    options=DdsOptions, open=_dds,
)  # fmt: skip
RAYS = LidarKind(
    name="rays", about="a simulated one: rays in a room around a robot that stands", library="", extra="",
    options=RaysOptions, open=_rays,
)  # fmt: skip
UDP = LidarKind(
    name="udp", about="a Livox lidar that sends its packets to this machine", library="", extra="", options=UdpOptions,
    open=_udp,
)  # fmt: skip
