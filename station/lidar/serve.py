"""From a lidar to the bus: each cloud in one atomic write with its stamp, what its IMU measured beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from station.bus import codec, keys
from station.camera.feed import Feed, Kind
from station.lidar.source import Lidar, Scan
from station.life.server import Life
from station.optics import Mount, Optics
from station.point_cloud import SensorPose, encoded

_KIND = Kind("lidar", "clouds", told_late="fields")


def serve_lidar(
    life: Life, open_lidar: Callable[[], Lidar], *, name: str, facts: Mapping[str, Any], mount: Mount | None = None
) -> int:
    """Open a lidar and publish its clouds until the server is asked to stop; return the exit code.

    Args:
        life: The server's.
        open_lidar: Opens the lidar; called again after it was lost.
        name: Of the lidar, in its keys.
        facts: What a manifest says of the server, beside what the lidar itself says.
        mount: Where it is fixed, for its own axes; None where that is not known, and clouds are in its own frame.

    Raises:
        LidarError: the lidar cannot be opened at the start.
    """
    key, imu_key = keys.lidar_cloud(name), keys.lidar_imu(name)
    pose = None if mount is None else SensorPose(mount.position_m, mount.quat_wxyz)

    def values(scan: Scan) -> dict[str, bytes]:
        life.report(points=scan.cloud.points)
        placed = scan.cloud if mount is None or pose is None else scan.cloud._replace(frame=mount.parent, pose=pose)
        return {key: encoded(placed)}

    def publish_imu(lidar: Lidar) -> None:
        samples = lidar.imu()
        life.bus.publish_in_turn([({imu_key: codec.f64(np.array(one.values))}, one.capture_ns) for one in samples])

    feed = Feed(
        life, open_lidar, _KIND, key=key, described=dict, values=values, beside=publish_imu,
        head={"server": life.name, "role": "sensor", "lidar": name, "key": key, **facts,
              **Optics(mount=mount).facts()},
    )  # fmt: skip
    return feed.run()
