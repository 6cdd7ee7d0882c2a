"""The camera server on a bus that stalls, and several of them in one station; what they show are files."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from pathlib import Path

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import ConnectionLost
from station.bus.sample import Sample
from tests.adapters.cameras import pictures
from tests.servers.camera_trials import stall_the_bus
from tests.waiting import DEADLINE_S, wait_until


def test_a_bus_that_stalls_gets_no_old_pictures_afterwards(processes: None, tmp_path: Path) -> None:
    stall_the_bus(tmp_path)


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
        Bus(bus_server, name="test", timeout_s=5.0) as bus,
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
