"""Options of the lidars, as they are written in settings."""

from __future__ import annotations

from typing import Literal

import msgspec


class DdsOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `dds`.

    Attributes:
        interface: Network interface that the robot's cable is plugged into: ``eno1``; ``lo`` for this machine.
        domain: DDS domain: 0 for a robot.
        cloud: Topic of the clouds, of ROS 2's type PointCloud2.
        imu: Topic of the lidar's IMU, of ROS 2's type Imu; "" for none.
        acceleration: Unit in which the IMU tells its acceleration: at rest it is 9.8 or 1.
        reliability: What is asked of the sender: ``reliable`` has lost packets of a cloud sent again, ``best-effort``
            also hears one that does not offer that.
    """

    interface: str = "lo"
    domain: int = 0
    cloud: str = "rt/utlidar/cloud_livox_mid360"
    imu: str = "rt/utlidar/imu_livox_mid360"
    acceleration: Literal["m/s^2", "g"] = "m/s^2"
    reliability: Literal["reliable", "best-effort"] = "reliable"

    def __post_init__(self) -> None:
        if not self.cloud:
            raise ValueError('cloud is ""; expected the name of a topic')
        if not 0 <= self.domain <= 230:
            raise ValueError(f"domain is {self.domain}; expected 0 to 230")


class RaysOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `rays`.

    Attributes:
        points: Of each cloud.
        rate_hz: Clouds per second [Hz].
        seed: Of the room, its noise, and the points that are lost.
    """

    points: int = 20_000
    rate_hz: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.points <= 1_000_000:
            raise ValueError(f"points is {self.points}; expected 1 to 1000000")
        if not 0.1 <= self.rate_hz <= 100.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 0.1 to 100 Hz")


class UdpOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `udp`.

    Attributes:
        address: Of this machine, in the lidar's network; ``0.0.0.0`` for any.
        lidar: Address of the lidar; "" hears whoever sends.
        point_port, imu_port: Where it sends points and its IMU.
        rate_hz: Clouds per second that its packets are put together to [Hz].
    """

    address: str = "0.0.0.0"
    lidar: str = ""
    point_port: int = 56301
    imu_port: int = 56401
    rate_hz: float = 10.0

    def __post_init__(self) -> None:
        for name, port in (("point_port", self.point_port), ("imu_port", self.imu_port)):
            if not 1 <= port <= 65535:
                raise ValueError(f"{name} is {port}; expected 1 to 65535")
        if not 0.1 <= self.rate_hz <= 100.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 0.1 to 100 Hz")
