"""A robot, its commander and a recorder under a supervisor, on a bus that is there to be broken; writers that count."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

from adapters.robots.g1 import twist_keys
from servers.g1 import G1Config
from servers.motion import MotionConfig
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.keeper import KeptServer
from station.bus.server_options import ServerOptions
from station.episode.quality.check import check
from station.episode.quality.findings import Interruption, Quality
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.storage.manifest import load_manifest
from station.errors import BusError
from tests.faults.recorded_station import RecordedStation
from tests.waiting import wait_until

ROBOT = twist_keys.TWIST2_ROBOT
SERVERS = ["g1", "motion", "recorder"]

_WRITERS = """
import sys, threading, time
from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import parse
from station.bus.client import Bus
from station.bus.connection import Connection, ConnectionLost
from station.errors import BusError

def plain_set(value):
    global plain
    while not stop.is_set():
        try:
            return plain.call("SET", "stock_counter", value)
        except ConnectionLost:
            try:
                plain = Connection(address, timeout_s=5.0)
            except ConnectionLost:
                time.sleep(0.02)
        except BusError:  # it takes none: a stock script would end here
            return

address, period_s = parse(sys.argv[1]), float(sys.argv[2])
stop = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
bus, plain, n = Bus(address, name="writer"), Connection(address, timeout_s=5.0), 0
while not stop.is_set():
    n += 1
    bus.publish({twist_keys.action_body(): codec.json_vector([float(n)] * 35), "own": n.to_bytes(8, "little")})
    plain_set(b"%d" % n)
    time.sleep(period_s)
while not bus.is_connected or bus.is_late:
    bus.publish({"last": b"1"})
    time.sleep(0.01)
print(n, bus.lost_writes, flush=True)
"""


class Writers:
    """A process that goes on writing whatever becomes of the bus: two native keys and, like a stock script, a third."""

    def __init__(self, address: BusAddress, period_s: float = 0.003) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", _WRITERS, address.url, str(period_s)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def stop(self) -> tuple[int, int]:
        """Return how often each native key was written, and how many of these writes the writer knows to be lost."""
        out, _ = self.process.communicate(timeout=30)
        count, lost = (int(word) for word in out.split())
        return count, lost


class RobotStation(RecordedStation):
    """A simulated robot that follows a motion, and a recorder; `g1` are settings of the robot's server."""

    def __init__(
        self, address: BusAddress, bus: Bus, folder: Path, *, g1: Mapping[str, Any] | None = None, **config: Any
    ) -> None:
        super().__init__(address, bus, folder, **config)
        light = G1Config(physics_dt_s=0.002, real_time_priority=0, **(g1 or {}))
        self.supervisor.spawn("g1", light)
        self.supervisor.spawn("motion", MotionConfig(motion="builtin:wave", loop=True, enter_s=0.1, leave_s=0.1))
        for name in ("g1", "motion"):
            self.supervisor.wait_for(name, "inactive", 60)
            self.supervisor.activate(name)

    def gate(self) -> str:
        """Return the state of the gate as the bus has it; "" while there is none."""
        try:
            value = self.bus.get(keys.command_gate(ROBOT))
        except BusError:
            return ""
        return str(codec.parse_json(value)["state"]) if value else ""

    def log(self, name: str) -> str:
        """Return what a server has printed."""
        return Path(self.supervisor.children[name].process.log).read_text(errors="replace")

    def told(self, folder: Path, event: str) -> list[str]:
        """Return the servers whose event of a name is in the manifest on the disk, sorted."""
        return sorted(found.source for found in load_manifest(folder).events if found.name == event)


@contextmanager
def kept_bus(folder: Path) -> Iterator[KeptServer]:
    """A bus that is started again when it dies."""
    place = folder / "bus"
    place.mkdir()
    with KeptServer.start(ServerOptions(folder=place, socket=place / "bus.sock")) as kept:
        yield kept


@contextmanager
def robot_station(address: BusAddress, folder: Path, **config: Any) -> Iterator[RobotStation]:
    with Bus(address, name="test", timeout_s=5.0) as bus:
        station = RobotStation(address, bus, folder, **config)
        try:
            wait_until(lambda: station.gate() == "tracking")
            yield station
        finally:
            station.supervisor.stop_all()


@contextmanager
def frozen(pid: int) -> Iterator[None]:
    """A process that is stopped for the length of a block."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def pid_of(address: BusAddress) -> int:
    """Return the process id of a bus server."""
    connection = Connection(address, timeout_s=5.0)
    try:
        return int(connection.call("INFO", "server").split(b"process_id:")[1].split()[0])
    finally:
        connection.close()


def gate_states(reader: EpisodeReader) -> list[str]:
    """Return the states of the gate in the order in which it went through them."""
    states = [str(codec.parse_json(message.data)["state"]) for message in reader.messages([keys.command_gate(ROBOT)])]
    return [state for state, _ in groupby(states)]


def checked(folder: Path) -> Quality:
    return check(open_episode(folder))


def of_kind(quality: Quality, kind: str) -> list[Interruption]:
    return [found for found in quality.interruptions if found.kind == kind]


def rules(quality: Quality) -> set[str]:
    return {reason.rule for reason in quality.reasons}


def missing(folder: Path, key: str, written: int, writer: str = "writer") -> set[int]:
    """Return the sequence numbers of a writer that counts which an episode lacks; fail where one is there twice."""
    numbers = [m.sequence for m in open_episode(folder).messages([key]) if m.channel.writer == writer]
    assert len(set(numbers)) == len(numbers)
    return set(range(1, written + 1)) - set(numbers)


def lost(quality: Quality) -> int:
    return sum(stream.lost for stream in quality.streams)


def soon(condition: Callable[[], object]) -> None:
    """Wait for a condition that asks a bus which may be gone."""

    def holds() -> bool:
        try:
            return bool(condition())
        except BusError:
            return False

    wait_until(holds)


def pause(seconds: float) -> None:
    """Let a fault last: its length is what is tested."""
    time.sleep(seconds)
