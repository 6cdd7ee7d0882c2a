"""A recorder under a real supervisor, and writers whose every write is accounted for."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
from mcap.reader import make_reader

from adapters.robots.g1 import twist_keys
from servers.recorder import RecorderConfig
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.frames import captured_ns
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote
from station.episode.storage.manifest import load_manifest
from station.episode.storage.request import RecordAnswer, RecorderState
from station.life.restarts import Restarts
from station.supervision.supervisor import Supervisor
from tests.episode.filming import jpeg
from tests.waiting import wait_until

BODY = twist_keys.action_body()
CAMERA = keys.camera_image("head")
STOCK = "stock_counter"
PICTURE_HZ = 30.0

_WRITERS = """
import sys, threading, time
from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import parse
from station.bus.client import Bus
from station.bus.connection import Connection
from tests.episode.filming import jpeg

address, period_s = parse(sys.argv[1]), float(sys.argv[2])
stop = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
bus, plain, n = Bus(address, name="g1", timeout_s=5.0), Connection(address, timeout_s=5.0), 0
camera, pictures, picture_s = Bus(address, name="camera", timeout_s=5.0), 0, float(sys.argv[3])
due = picture_due = time.monotonic()
while not stop.is_set():
    n += 1
    assert bus.publish({twist_keys.action_body(): codec.json_vector([float(n)] * 35), "own": n.to_bytes(8, "little")})
    plain.call("SET", "stock_counter", b"%d" % n)
    if picture_s and time.monotonic() >= picture_due:
        pictures, picture_due = pictures + 1, picture_due + picture_s
        taken = time.monotonic_ns() - 5_000_000
        assert camera.publish({keys.camera_image("head"): jpeg(pictures, 30_000)}, capture_ns=taken)
    due += period_s
    time.sleep(max(0.0, due - time.monotonic()))
print(n, bus.lost_writes + camera.lost_writes, pictures, flush=True)
"""


class Writers:
    """A process that writes two native keys and a foreign one, all counting from 1, until it is told to stop.

    With `films`, it is a camera as well, of 30 pictures a second; after `stop`, `pictures` says how many.
    """

    def __init__(self, address: BusAddress, period_s: float, *, films: bool = False) -> None:
        self.pictures = 0
        self.process = subprocess.Popen(
            [sys.executable, "-c", _WRITERS, address.url, str(period_s), str(films / PICTURE_HZ)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def stop(self) -> int:
        """Return how often each key was written."""
        out, _ = self.process.communicate(timeout=30)
        count, lost, self.pictures = (int(word) for word in out.split())
        assert lost == 0, "the bus itself lost writes"
        return count


class RecordedStation:
    """A supervisor with a recorder, on a bus."""

    def __init__(self, address: BusAddress, bus: Bus, folder: Path, **config: Any) -> None:
        self.address, self.bus, self.data = address, bus, folder / "data"
        self.supervisor = Supervisor(bus, folder / "logs")
        settings = RecorderConfig(**{"data": self.data, "min_free_mb": 0, **config})
        self.supervisor.spawn("recorder", settings, restarts=Restarts())
        self.supervisor.wait_for("recorder", "inactive", 60)
        self.supervisor.activate("recorder")
        self.supervisor.wait_for("recorder", "active", 60)

    @property
    def pid(self) -> int:
        return self.supervisor.children["recorder"].process.pid

    def kill(self) -> int:
        """``kill -9`` the recorder that is there now, whatever it does; return its pid."""
        pid = self.pid
        os.kill(pid, signal.SIGKILL)
        return pid

    def wait_for_another(self, pid: int) -> None:
        """Wait until the supervisor has started a recorder after one with a pid."""
        wait_until(lambda: self.pid != pid)

    def state(self) -> RecorderState | None:
        value = self.bus.get(keys.RECORDER)
        return msgspec.json.decode(value, type=RecorderState) if value else None

    def wait_until_it_records(self, messages: int = 0) -> None:
        """Wait until the present recorder is active, and has at least so many messages in the file."""
        self.supervisor.wait_for("recorder", "active", 60)
        wait_until(lambda: (found := self.state()) is not None and found.messages >= messages)

    def ask(self, action: Any, **fields: Any) -> RecordAnswer:
        return remote.ask(self.bus, action, timeout_s=60.0, **fields)

    def events(self, folder: Path) -> list[str]:
        return [event.name for event in load_manifest(folder).events]


@contextmanager
def recorded_station(address: BusAddress, folder: Path, **config: Any) -> Iterator[RecordedStation]:
    with Bus(address, name="test", timeout_s=5.0) as bus:
        station = RecordedStation(address, bus, folder, **config)
        try:
            yield station
        finally:
            station.supervisor.stop_all()


def assert_holds_everything(folder: Path, written: int) -> None:
    """Every write from the first to the last, once, in order, byte for byte, with its stamp where it has one."""
    reader = open_episode(folder)
    assert reader.torn is None
    assert not reader.is_active
    found = list(reader.messages(stamps=True))
    body = [m for m in found if m.topic == BODY]
    assert [m.sequence for m in body] == list(range(1, written + 1))
    assert [m.data for m in body] == [codec.json_vector([float(n)] * 35) for n in range(1, written + 1)]
    assert all(m.stamp is not None and int(m.stamp.split()[0]) == m.sequence for m in body)
    own = [m for m in found if m.topic == "own"]
    assert [int.from_bytes(m.data, "little") for m in own] == list(range(1, written + 1))
    stock = [m for m in found if m.topic == STOCK]
    assert [(m.sequence, int(m.data)) for m in stock] == [(n, n) for n in range(1, written + 1)]
    assert all(stream.lost == stream.repeated == 0 for stream in reader.manifest.streams)
    in_files = 0
    for path in reader.files:
        with path.open("rb") as file:
            library = make_reader(file, validate_crcs=True)
            kept = sum(1 for _ in library.iter_messages(topics=[BODY, "own", STOCK]))
            assert kept == (3 * written if path == reader.path else 0)
            statistics = library.get_summary().statistics
        in_files += statistics.message_count - statistics.channel_message_counts[1]  # channel 1 holds the stamps
    counted = reader.manifest.recorder.messages
    assert counted == sum(stream.count for stream in reader.manifest.streams) == len(found) == in_files


def assert_holds_every_picture(folder: Path, written: int) -> None:
    """Every picture of `Writers`, once, in order, byte for byte, with the time at which it was taken."""
    reader = open_episode(folder)
    assert [path.name for path in reader.files] == ["signals.mcap", "cameras.mcap"]
    found = list(reader.messages([CAMERA], stamps=True))
    assert [m.sequence for m in found] == list(range(1, written + 1))
    assert [m.data for m in found] == [jpeg(number, 30_000) for number in range(1, written + 1)]
    assert {m.channel.file for m in found} == {"cameras.mcap"}
    assert all(captured_ns(m) < m.publish_ns for m in found)
    logged = [message.log_ns for message in reader.messages()]
    assert logged == sorted(logged), "both files go on with the same clock"
