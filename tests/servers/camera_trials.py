"""A camera server on a bus that stalls: which pictures it gets afterwards, and how old they are."""

from __future__ import annotations

import time
from pathlib import Path

from station.bus.redis_server import RedisServer, ServerOptions
from tests.adapters.cameras import pictures
from tests.faults.bus_station import frozen, pause
from tests.servers.camera_station import camera_station

STALLED_S, FPS = 1.5, 50.0


def stall_the_bus(folder: Path) -> float:
    """Freeze the bus of a camera; return how long after it was taken the oldest picture was written since [s]."""
    album = folder / "album"
    album.mkdir()
    for number in range(64):
        (album / f"{number}.jpg").write_bytes(pictures.jpeg(number))
    options = ServerOptions(folder=folder, socket=folder / "bus.sock")
    with RedisServer.start(options) as server, camera_station("head", server.address, folder) as station:
        station.start("files", options={"path": str(album)}, fps=FPS)
        station.until(lambda: len(station.shots) > 10)
        with frozen(server.pid):
            began_ns = time.monotonic_ns()
            pause(STALLED_S)
            ended_ns = time.monotonic_ns()
        before = len(station.shots)
        station.until(lambda: len(station.shots) > before + 20)
        station.until(lambda: station.detail.get("unsent"))
    during = [shot for shot in station.shots if began_ns < shot.stamp.mono_ns < ended_ns]
    assert len(during) < 20, "of seventy-five pictures a stalled bus gets those that were on their way"
    late = [shot for shot in station.shots if shot.stamp.mono_ns > began_ns]
    return max(shot.stamp.mono_ns - (shot.stamp.capture_ns or 0) for shot in late) * 1e-9
