"""What a source of point clouds is to the lidar server. Knows no source and no bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import msgspec

from station.camera.source import Drops, SensorError
from station.point_cloud import PointCloud


class LidarError(SensorError):
    """A lidar that is missing, refused, torn out or misconfigured; one line that says what to do."""


class Scan(NamedTuple):
    """One cloud.

    Attributes:
        cloud: In the sensor's own frame; sound, as `station.point_cloud.expect_sound` has it.
        capture_ns: When it was whole, on this machine's monotonic clock [ns].
    """

    cloud: PointCloud
    capture_ns: int


class ImuSample(NamedTuple):
    """What the IMU in a lidar measured, in the lidar's own frame.

    Attributes:
        values: Angular velocity [rad/s], then acceleration [m/s^2]: six numbers.
        capture_ns: When, on this machine's monotonic clock [ns].
    """

    values: tuple[float, ...]
    capture_ns: int


@runtime_checkable
class Lidar(Protocol):
    """A source of point clouds, opened by its constructor, which raises `LidarError` when it cannot be used.

    Attributes:
        drops: What it has dropped so far; it goes on counting there.
    """

    drops: Drops

    def read(self, timeout_s: float) -> Scan | None:
        """Return the newest cloud that was not given before, waiting for one no longer than a time [s].

        Older ones that have queued up are left out and counted.

        Raises:
            LidarError: the lidar is gone, and this object will never give a cloud again.
        """
        ...

    def imu(self) -> Sequence[ImuSample]:
        """Return what its IMU measured since the last call, oldest first; nothing of one that has none."""
        ...

    def why_silent(self) -> str:
        """Return in one line why there may be no cloud, and what to do; "" when nothing is known."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this lidar.

        Always ``device``, ``capture`` (what the time of capture means), ``fps`` (clouds per second, None where the
        source does not say), ``frame`` and ``fields`` (each with name, offset and type), None before the first cloud.
        """
        ...

    def close(self) -> None:
        """Release the lidar; a second call does nothing."""
        ...


@dataclass(frozen=True, kw_only=True)
class LidarKind:
    """A kind of lidar; registered under ``station.lidars``, imports nothing heavy.

    Attributes:
        name: As the setting `source` of the lidar server has it.
        about: What it is, in a line.
        library: The package that it needs; "" for none.
        extra: The extra of this package that brings the library; "" for none.
        options: Type of its options.
        open: Opens a lidar of options; imports what is heavy.
    """

    name: str
    about: str
    library: str
    extra: str
    options: type[msgspec.Struct]
    open: Callable[[Any], Lidar]
