"""The camera server on a bus that stalls, and several of them in one station; what they show are files."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import ConnectionLost
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.sample import Sample
from tests.adapters.cameras import pictures
from tests.lateness import TooLate, Waits, in_time
from tests.servers.camera_station import camera_station
from tests.waiting import DEADLINE_S, wait_until

OLD_S = 0.5  # no picture goes to the bus so long after it was taken


def test_a_bus_that_stalls_gets_no_old_pictures_afterwards(tmp_path: Path) -> None:
    for number in range(64):
        (tmp_path / f"{number}.jpg").write_bytes(pictures.jpeg(number))
    in_time(lambda: stall_the_bus(tmp_path, Path(tempfile.mkdtemp(dir=tmp_path))))


def stall_the_bus(album: Path, folder: Path) -> None:
    options = ServerOptions(folder=folder, socket=folder / "bus.sock")
    with (
        Waits.watched() as waits,
        RedisServer.start(options) as server,
        camera_station("head", server.address, folder) as station,
    ):
        station.start("files", options={"path": str(album)}, fps=50.0)
        station.until(lambda: len(station.shots) > 10)
        os.kill(server.pid, signal.SIGSTOP)
        stalled_ns = station.shots[-1].stamp.mono_ns
        try:
            wait_until(lambda: _is_over(stalled_ns, 1.5))
        finally:
            os.kill(server.pid, signal.SIGCONT)
        before = len(station.shots)
        station.until(lambda: len(station.shots) > before + 20)
        station.until(lambda: station.detail.get("unsent"))
        late = [shot for shot in station.shots if shot.stamp.mono_ns > stalled_ns]
        during = [shot for shot in late if shot.stamp.mono_ns < stalled_ns + 1_400_000_000]
        assert len(during) < 20, "of seventy pictures a stalled bus gets those that were on their way"
        oldest_s = max(shot.stamp.mono_ns - (shot.stamp.capture_ns or 0) for shot in late) * 1e-9
        waits.seconds()
    if oldest_s >= OLD_S:
        raise TooLate("a picture", oldest_s - OLD_S, waits.longest_s)


def _is_over(since_ns: int, seconds: float) -> bool:
    return time.monotonic_ns() - since_ns > seconds * 1e9


BOOK = """
runbook: two-cameras
robot: unitree_g1_with_hands
steps:
  - start: head
    server: camera
    with: {{source: files, options: {{path: {folder}}}, fps: 20}}
  - start: left_wrist
    server: camera
    with: {{source: files, options: {{path: {folder}}}, fps: 20}}
"""


def test_a_runbook_starts_several_under_names_of_their_own(bus_server: BusAddress, tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    (folder / "1.jpg").write_bytes(pictures.jpeg(1))
    book = tmp_path / "book.yaml"
    book.write_text(BOOK.format(folder=folder))
    command = [sys.executable, "-m", "station", "up", str(book), "--yes", "--for", "60s", "--bus", bus_server.url]
    with (
        subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        ) as process,
        Bus(bus_server, name="test") as bus,
    ):
        wanted = [keys.camera_image("head"), keys.camera_image("left_wrist")]
        found: dict[str, Sample] = {}

        def are_there() -> bool:
            with contextlib.suppress(ConnectionLost):  # a machine that is busy owes an answer for a moment
                found.update(bus.read(wanted))
            return len(found) == 2

        wait_until(lambda: process.poll() is not None or are_there(), 2 * DEADLINE_S)
        process.send_signal(signal.SIGINT)
        told = process.communicate(timeout=DEADLINE_S)[0].decode()
    assert sorted(found) == wanted, told
    assert {sample.stamp.writer for sample in found.values() if sample.stamp} == {"head", "left_wrist"}
    assert "start head (camera)" in told
