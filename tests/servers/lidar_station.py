"""A lidar server as a process of its own, and a lidar on a DDS domain of its own that sends what the test wants."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from station.bus import keys
from station.bus.address import BusAddress
from tests.servers.camera_station import CameraStation

MOUNT = {"parent": "torso_link", "position_m": [0.0003, 0.0, 0.416], "rpy_rad": [0.0, 3.101, 3.1415]}


class LidarStation(CameraStation):
    """One lidar server and everything that it writes to the bus; each shot is a cloud."""

    kind = "lidar"
    key = staticmethod(keys.lidar_cloud)


@contextlib.contextmanager
def lidar_station(name: str, address: BusAddress, folder: Path) -> Iterator[LidarStation]:
    """Give a lidar server that is closed at the end."""
    made = LidarStation(name, address, folder)
    try:
        yield made
    finally:
        made.close()


@contextlib.contextmanager
def recorder(address: BusAddress, data: Path, **settings: Any) -> Iterator[subprocess.Popen]:
    """Run a recorder."""
    config = json.dumps({"data": str(data), "min_free_mb": 0, "preroll_s": 0, **settings})
    command = [sys.executable, "-m", "station", "serve", "recorder", "--bus", address.url, "--config-json", config]
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        yield child
    finally:
        child.terminate()
        child.wait()
