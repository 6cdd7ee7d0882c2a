"""More comes than the disk takes: images go, signals stay, and of every write it is known where it went."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import Manifest, load_manifest
from station.episode.storage.progress import load_resume_point
from tests.faults.disks import BadDisk
from tests.faults.recorded_station import RecordedStation, Writers, assert_holds_everything, recorded_station
from tests.waiting import wait_until

PERIOD_S = 0.005
CAMERAS = (keys.camera_image("left"), keys.camera_image("right"))
BURST = 300  # images of 100 kB
QUEUE_MB, FLUSH_KB, FLUSH_TAKES_S = 8.0, 1000.0, 0.1  # a disk of 10 MB a second

_CAMERAS = """
import os, sys, threading, time
from station.bus.address import parse
from station.bus.client import Bus

address, mb_per_s, names = parse(sys.argv[1]), float(sys.argv[2]), sys.argv[3:]
stop = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
noise, n = os.urandom(100_000), 0
with Bus(address, name="camera", timeout_s=5.0) as bus:
    due = time.monotonic()
    while not stop.is_set():
        n += 1
        for name in names:
            assert bus.publish({name: n.to_bytes(8, "little") + noise})
        due += len(names) * 0.1 / mb_per_s
        time.sleep(max(0.0, due - time.monotonic()))
    print(n, flush=True)
"""


class Cameras:
    """A process that writes numbered images of 100 kB on two keys until it is told to stop."""

    def __init__(self, address: BusAddress, mb_per_s: float) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", _CAMERAS, address.url, str(mb_per_s), *CAMERAS],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def stop(self) -> int:
        """Return how many images of each camera were written."""
        out, _ = self.process.communicate(timeout=30)
        return int(out)


@pytest.fixture
def slow_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> BadDisk:
    disk = BadDisk(tmp_path, tmp_path / "data", monkeypatch)
    disk.order(f"wait {FLUSH_TAKES_S}", "fdatasync")
    return disk


def dropped(station: RecordedStation) -> int:
    state = station.state()
    return state.dropped if state is not None and state.state == "recording" else 0


def images_are_accounted_for(folder: Path, written: int) -> Manifest:
    """Every image is in the file, once and in order, or counted as dropped; return the manifest."""
    reader = open_episode(folder)
    streams = {stream.key: stream for stream in reader.manifest.streams}
    for camera in CAMERAS:
        kept = [int.from_bytes(message.data[:8], "little") for message in reader.messages([camera])]
        assert kept == sorted(set(kept))
        assert streams[camera].count == len(kept)
        assert len(kept) + streams[camera].dropped == written
        assert streams[camera].dropped_bulky == streams[camera].dropped
        assert reader.drops().by_key(9).get(camera, 0) == streams[camera].dropped
    assert reader.manifest.recorder.dropped == sum(streams[camera].dropped for camera in CAMERAS)
    return reader.manifest


def test_on_a_slow_disk_images_are_thinned_out_and_every_command_stays(
    bus_server: BusAddress, tmp_path: Path, slow_disk: BadDisk
) -> None:
    with recorded_station(bus_server, tmp_path, queue_mb=QUEUE_MB, flush_kb=FLUSH_KB) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        cameras, writers = Cameras(bus_server, 60.0), Writers(bus_server, PERIOD_S)
        wait_until(lambda: dropped(station) > 300)
        images = cameras.stop()
        slow_disk.heal()
        wait_until(lambda: station.events(folder).count("images-dropped") == 2)  # it began, and it ended
        written = writers.stop()
        ended = station.ask("stop")
    assert_holds_everything(folder, written)
    manifest = images_are_accounted_for(folder, images)
    assert ended.summary["dropped"] == manifest.recorder.dropped > 300
    events = [event for event in manifest.events if event.name.endswith("-dropped")]
    assert [(event.name, event.severity) for event in events] == [("images-dropped", "warning")] * 2
    assert events[1].numbers["dropped"] == manifest.recorder.dropped
    assert sum(events[1].numbers["keys"].values()) == manifest.recorder.dropped
    quality = check(open_episode(folder))
    verdicts = {reason.rule: reason.verdict for reason in quality.reasons}
    assert verdicts["dropped-images"] == "usable"
    assert not {"dropped", "lost"} & set(verdicts)
    assert all(stream.lost == 0 for stream in quality.streams)


def test_a_recorder_that_is_killed_while_it_drops_goes_on_counting_where_it_was(
    bus_server: BusAddress, tmp_path: Path, slow_disk: BadDisk
) -> None:
    """The bus could keep 128 MiB for it, and would then cut it off: it does not wait for so long."""
    with recorded_station(bus_server, tmp_path, queue_mb=QUEUE_MB, flush_kb=FLUSH_KB) as station:
        for name, value in (
            ("repl-backlog-size", 128 << 20),
            ("client-output-buffer-limit", f"replica {128 << 20} 0 0"),
        ):
            station.bus.call("CONFIG", "SET", name, value)
        folder = Path(station.ask("start", task="walk").path or "")
        cameras, writers = Cameras(bus_server, 30.0), Writers(bus_server, PERIOD_S)
        wait_until(lambda: (point := load_resume_point(folder)) is not None and point.dropped > 100)
        pid = station.kill()
        station.wait_for_another(pid)
        wait_until(lambda: (state := station.state()) is not None and state.restarts == 1 and state.dropped > 300)
        written, images = writers.stop(), cameras.stop()
        slow_disk.heal()
        station.ask("stop")
    assert [note["by"] for note in load_manifest(folder).recovery] == ["offset"]
    assert "tap-lost" not in station.events(folder)
    assert_holds_everything(folder, written)
    images_are_accounted_for(folder, images)


def test_what_waited_for_a_recorder_that_was_killed_is_read_at_the_pace_of_the_disk_and_nothing_is_dropped(
    bus_server: BusAddress, tmp_path: Path, slow_disk: BadDisk
) -> None:
    """What comes while it catches up takes three times the room that the queue has for images."""
    with recorded_station(bus_server, tmp_path, queue_mb=QUEUE_MB, flush_kb=FLUSH_KB) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        cameras, writers = Cameras(bus_server, 4.0), Writers(bus_server, PERIOD_S)
        station.wait_until_it_records(messages=300)
        pid = station.kill()
        image = os.urandom(100_000)
        for number in range(BURST):
            assert station.bus.publish({"camera_burst": number.to_bytes(8, "little") + image})
        station.wait_for_another(pid)
        station.wait_until_it_records(messages=300 + BURST + 1500)
        written, images = writers.stop(), cameras.stop()
        ended = station.ask("stop")
    assert ended.summary["dropped"] == 0
    assert_holds_everything(folder, written)
    assert images_are_accounted_for(folder, images).recorder.restarts == 1
    burst = [int.from_bytes(message.data[:8], "little") for message in open_episode(folder).messages(["camera_burst"])]
    assert burst == list(range(BURST))


def test_one_enormous_value_costs_neither_the_recorder_nor_its_neighbours(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    """The queue is 8 MB here and the value 60, which is nearly the most that a bus of ours takes."""
    enormous = bytes(60_000_000)
    with recorded_station(bus_server, tmp_path, queue_mb=QUEUE_MB, preroll_mb=16.0) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        pid, writers, line = station.pid, Writers(bus_server, PERIOD_S), Connection(bus_server, timeout_s=20.0)
        for count in (200, 400, 600):
            station.wait_until_it_records(messages=count)
            line.call("SET", "enormous", enormous)
        wait_until(lambda: dropped(station) == 3)
        written = writers.stop()
        line.close()
        station.ask("stop")
        assert station.pid == pid
    assert_holds_everything(folder, written)
    assert open_episode(folder).drops().by_key(9) == {"enormous": 3}
    assert "images-dropped" in station.events(folder)
