"""A lidar's server and a recorder on a bus and its bulk bus, each a process: clouds go, are read, recorded, survive."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from station import Station
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.keeper import KeptServer
from station.bus.server_options import ServerOptions, bulk_options
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote
from station.life.server import read_health
from tests.servers.lidar_station import recorder
from tests.waiting import wait_until

CLOUD = keys.lidar_cloud("top")


@contextlib.contextmanager
def lidar(address: BusAddress) -> Iterator[None]:
    """Run a simulated lidar."""
    command = [sys.executable, "-m", "station", "serve", "lidar", "--name", "top", "--set", "source=rays",
               "--bus", address.url]  # fmt: skip
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        child.terminate()
        child.wait()


def test_clouds_are_read_and_recorded_from_the_bulk_bus_and_survive_its_death(processes: None, tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    with (
        KeptServer.start(options) as bus,
        KeptServer.start(bulk_options(options)) as bulk,
        recorder(bus.address, tmp_path / "data"),
        lidar(bus.address),
        Bus(bus.address, name="test", timeout_s=5.0) as line,
        Station(bus.address.url) as lab,
    ):

        def alive() -> set[str]:
            return {health.name for health in read_health(line) if health.is_alive and health.state == "active"}

        wait_until(lambda: alive() == {"recorder", "top"} and lab.cloud("top") is not None)
        assert line.call("EXISTS", CLOUD) == 0, "not on the bus of the robot"
        remote.ask(line, "start", task="look")
        seen = lab.follow(CLOUD)
        for _ in range(3):
            next(seen)
        os.kill(bulk.pid, signal.SIGKILL)
        wait_until(lambda: bulk.restarts == 1)
        for _ in range(10):
            next(seen)
        assert alive() == {"recorder", "top"}
        wait_until(lambda: any(event.name == "bus-back" and event.detail["bus"] == "bulk"
                               for health in read_health(line) for event in health.events))  # fmt: skip
        folder = remote.ask(line, "stop").path
    reader = open_episode(str(folder))
    assert reader.manifest.recorder.bulk == str(bulk.address)
    assert [hole.reason for hole in reader.manifest.holes] == ["bulk bus: the bus was restarted, or is another server"]
    quality = check(reader)
    (clouds,) = [stream for stream in quality.streams if stream.key == CLOUD]
    assert clouds.count >= 10
    assert {item.kind for item in quality.interruptions} == {"hole", "bulk-cut"}
    assert all(item.lost == 0 for item in quality.interruptions if item.kind == "bus-lost")
