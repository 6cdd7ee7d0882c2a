"""A simulated lidar in this process, for machines without a sensor and without DDS."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import mujoco

from adapters.cameras.pace import Pace
from adapters.lidars.options import RaysOptions
from adapters.lidars.room import FRAME, Room
from station.camera.source import Drops
from station.lidar.source import ImuSample, Scan
from station.point_cloud import PointField

_IMU_NS = 5_000_000  # 200 Hz
_MOST_SAMPLES = 256  # after a pause of the process


class RaysLidar:
    """Looks around in a room; implements `station.lidar.source.Lidar`.

    Args:
        options: Points and rate.
    """

    def __init__(self, options: RaysOptions) -> None:
        self.drops = Drops()
        self._options, self._room = options, Room(options.points, seed=options.seed)
        self._pace, self._imu_ns = Pace(options.rate_hz), time.monotonic_ns()
        self._fields: tuple[PointField, ...] | None = None

    def read(self, timeout_s: float) -> Scan | None:
        """Return a cloud when the next is due; see `Lidar.read`."""
        before = self._pace.index
        due_ns = self._pace.wait(timeout_s)
        if due_ns is None:
            return None
        self.drops.skipped += self._pace.index - before - 1
        cloud = self._room.cloud(time.time_ns())
        self._fields = cloud.fields
        return Scan(cloud, due_ns)

    def imu(self) -> Sequence[ImuSample]:
        """Return a sample for each of its periods that have passed."""
        now_ns, found = time.monotonic_ns(), []
        self._imu_ns = max(self._imu_ns, now_ns - _MOST_SAMPLES * _IMU_NS)
        while self._imu_ns <= now_ns:
            gyro, acceleration = self._room.imu()
            found.append(ImuSample((*gyro, *acceleration), self._imu_ns))
            self._imu_ns += _IMU_NS
        return found

    def why_silent(self) -> str:
        """Return "": it is never silent."""
        return ""

    def facts(self) -> dict[str, Any]:
        """Return what is simulated."""
        return {
            "device": "rays in a room",
            "frame": FRAME if self._fields else None,
            "fields": [field._asdict() for field in self._fields] if self._fields else None,
            "fps": self._options.rate_hz,
            "capture": "when the cloud was due, monotonic clock",
            "library": f"mujoco {mujoco.__version__}",
        }

    def close(self) -> None:
        """Do nothing."""
