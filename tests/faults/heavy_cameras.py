"""Images that come faster than a disk takes them, and where each of them went."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from station.bus import keys
from station.bus.address import BusAddress
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import Manifest
from tests.faults.recorded_station import RecordedStation, Writers, assert_holds_everything, recorded_station
from tests.waiting import wait_until

PERIOD_S = 0.005
CAMERAS = (keys.camera_image("left"), keys.camera_image("right"))
MORE = 40  # of each camera, while it catches up
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
        due = max(due, time.monotonic() - 0.5) + len(names) * 0.1 / mb_per_s  # what a pause kept back does not come
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

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Nothing comes during the block, and nothing is made up for afterwards."""
        self.process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self.process.send_signal(signal.SIGCONT)

    def stop(self) -> int:
        """Return how many images of each camera were written."""
        out, _ = self.process.communicate(timeout=30)
        return int(out)


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


def _newest(station: RecordedStation) -> int:
    """Return the number of the newest image of a camera on the bus; 0 while there is none."""
    image = station.bus.get(CAMERAS[-1])
    return int.from_bytes(image[:8], "little") if image else 0


def catch_up(address: BusAddress, place: Path, burst: int = 100) -> tuple[int, bool]:
    """Kill a recorder on a slow disk while a burst of images waits for it; return how many it dropped, and whether it
    says that it was too slow to catch up.

    What waits, and the 8 MB that come while it catches up, is several times what the queue has room for.

    Args:
        address: Of the bus.
        place: For everything that is written.
        burst: Images of 100 kB that wait.
    """
    with recorded_station(address, place, queue_mb=QUEUE_MB, flush_kb=FLUSH_KB) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        cameras, writers = Cameras(address, 4.0), Writers(address, PERIOD_S)
        station.wait_until_it_records(messages=300)
        with cameras.paused():  # what comes is bounded, however long another takes to come
            pid, before = station.kill(), _newest(station)
            image = os.urandom(100_000)
            for number in range(burst):
                assert station.bus.publish({"camera_burst": number.to_bytes(8, "little") + image})
            station.wait_for_another(pid)
        wait_until(lambda: _newest(station) >= before + MORE)
        images = cameras.stop()
        station.wait_until_it_records(messages=300 + burst + 1500)
        written = writers.stop()
        ended = station.ask("stop")
        events = station.events(folder)
    assert_holds_everything(folder, written)
    assert images_are_accounted_for(folder, images).recorder.restarts == 1
    kept = [int.from_bytes(message.data[:8], "little") for message in open_episode(folder).messages(["camera_burst"])]
    assert kept == list(range(burst))
    return int(ended.summary["dropped"]), "recorder-behind" in events


def kill_under_images(address: BusAddress, place: Path, mb_per_s: float, kills: int) -> tuple[int, int]:
    """Kill a recorder while many images come; return how many came and how many were dropped, all accounted for."""
    with recorded_station(address, place) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        cameras, writers = Cameras(address, mb_per_s), Writers(address, PERIOD_S)
        for _ in range(kills):
            station.wait_until_it_records()
            state = station.state()
            station.wait_until_it_records(messages=(state.messages if state is not None else 0) + 1000)
            pid = station.kill()
            station.wait_for_another(pid)
        station.wait_until_it_records()
        written, images = writers.stop(), cameras.stop()
        ended = station.ask("stop")
    assert_holds_everything(folder, written)
    images_are_accounted_for(folder, images)
    return images * len(CAMERAS), int(ended.summary["dropped"])
