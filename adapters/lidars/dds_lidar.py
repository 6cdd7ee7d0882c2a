"""A robot's lidar on its DDS network. Needs the extra ``g1``.

Messages are taken as bytes: to make an object of a cloud takes 29 ms, and the bytes are what is recorded.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from importlib import metadata
from typing import Any

from adapters.lidars import dds_types
from adapters.lidars.options import DdsOptions
from adapters.lidars.ros_messages import parse_cloud, parse_imu
from adapters.robots.g1.dds.network import Network
from adapters.robots.g1.dds.options import NetworkOptions
from station.camera.source import Drops
from station.errors import ConfigError
from station.lidar.source import ImuSample, LidarError, Scan
from station.point_cloud import BadCloud, PointCloud

_CLOUDS = 2  # that wait here: one is taken while the next one comes
_SAMPLES = 256  # of the IMU, more than a second of them
_G = 9.80665


class DdsLidar:
    """Hears the topics of a lidar; implements `station.lidar.source.Lidar`. It comes and goes by itself.

    Args:
        options: Where it is.

    Raises:
        LidarError: there is no such interface, or DDS cannot use it.
    """

    def __init__(self, options: DdsOptions) -> None:
        self.drops = Drops()
        self._options = options
        self._refused = ""
        self._seen: PointCloud | None = None
        try:
            self._network = Network(NetworkOptions(interface=options.interface, domain=options.domain))
        except (ConfigError, ValueError) as error:
            raise LidarError(str(error)) from None
        is_reliable = options.reliability == "reliable"
        self._clouds = self._network.reader(
            options.cloud, dds_types.PointCloud2, _CLOUDS, is_reliable=is_reliable
        )  # fmt: skip
        self._imu = self._network.reader(options.imu, dds_types.Imu, _SAMPLES) if options.imu else None

    def read(self, timeout_s: float) -> Scan | None:
        """Return the newest cloud that has arrived; see `Lidar.read`."""
        if not self._clouds.wait(timeout_s):
            return None
        messages = self._clouds.take_stamped()
        now_ns, scan = time.monotonic_ns(), None
        for message in reversed(messages):
            if scan is not None:
                self.drops.skipped += 1
            elif (cloud := self._parsed(message.data)) is not None:
                scan = Scan(cloud, now_ns)
        return scan

    def imu(self) -> Sequence[ImuSample]:
        """Return the samples that have come; when each was taken, by when it was sent before the newest one."""
        messages = [] if self._imu is None else self._imu.take_stamped()
        if not messages:
            return []
        now_ns, sent_ns = time.monotonic_ns(), messages[-1].sample_info.source_timestamp
        scale, found = _G if self._options.acceleration == "g" else 1.0, []
        for message in messages:
            try:
                sample = parse_imu(message.data)
            except BadCloud as error:
                self._refuse(self._options.imu, error)
                continue
            acceleration = [scale * value for value in sample.acceleration]
            age_ns = max(0, sent_ns - message.sample_info.source_timestamp)
            found.append(ImuSample((*sample.gyro, *acceleration), now_ns - age_ns))
        return found

    def why_silent(self) -> str:
        """Return what is wrong with what comes, or who does not send."""
        if self._refused:
            return self._refused
        topic, where = self._options.cloud, f"{self._options.interface}, domain {self._options.domain}"
        writers = self._network.writers_of(topic)
        if not writers:
            return f"{topic}: nobody writes it on {where}; is the robot's lidar service on, is this its interface?"
        said = f"{topic}: {writers[0]} writes it, and nothing comes"
        if self._options.reliability == "reliable":
            return f"{said}; it may offer no reliable delivery: set options.reliability to best-effort"
        return f"{said}; does the sensor turn, does its type differ?"

    def facts(self) -> dict[str, Any]:
        """Return topic and interface, and how its points are laid out."""
        seen = self._seen
        return {
            "device": f"{self._options.cloud} on {self._options.interface}, domain {self._options.domain}",
            "frame": seen.frame if seen else None,
            "fields": [field._asdict() for field in seen.fields] if seen else None,
            "fps": None,
            "capture": "arrival: the message's own stamp is of the robot's clock, and stands in the cloud",
            "library": f"cyclonedds {metadata.version('cyclonedds')}",
        }

    def close(self) -> None:
        """Leave the network."""
        self._network.close()

    def _parsed(self, data: bytes) -> PointCloud | None:
        try:
            self._seen = parse_cloud(data)
        except BadCloud as error:
            self.drops.torn += 1
            self._refuse(self._options.cloud, error)
            return None
        self._refused = ""
        return self._seen

    def _refuse(self, topic: str, error: BadCloud) -> None:
        self._refused = f"{topic}: {error}; does the sender's type differ?"
