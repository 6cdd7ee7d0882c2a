"""``python -m tests.faults.soak_closing --minutes 10``: a recorder killed between one episode and the next.

Each call that brings data to the disk takes up to `--slow-flush` seconds longer. An episode is ended, the next one is
asked for at once, and the recorder is killed a moment later. In the end every episode that was asked for is looked for,
and every write in it. Prints one JSON line; the exit code is 1 when one of the first five figures is not 0.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from station.bus import keys
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.episode.reading.reader import open_episode
from station.episode.storage.left_open import left_open, not_begun
from station.episode.storage.manifest import load_manifest
from tests.faults.disks import BadDisk
from tests.faults.recorded_station import RecordedStation, recorded_station
from tests.waiting import wait_until

LIVED_S = 3.1  # a recorder that dies younger, again and again, is given up on purpose
PERIOD_S = 0.005
CALLS = ("fdatasync", "fsync")
FAULTS = ("missing", "twice", "not_asked_for", "left_open", "lost")


class Asked(NamedTuple):
    """An episode that was asked for: how much had been written when it was there, and when its end was asked for."""

    first: int
    last: int


class Counter:
    """Writes a number that grows to a key, from a thread of its own."""

    def __init__(self, bus: Bus) -> None:
        self.written = 0
        self._bus = bus
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._write)
        self._thread.start()

    def stop(self) -> None:
        self._done.set()
        self._thread.join()

    def _write(self) -> None:
        while not self._done.wait(PERIOD_S):
            assert self._bus.publish({"own": b"%d" % (self.written + 1)})
            self.written += 1


def soak(minutes: float, slow_s: float, seed: int) -> dict[str, int]:
    """Record, end, begin and kill for some minutes; return the figures."""
    chance, folder = random.Random(seed), Path(tempfile.mkdtemp(prefix="soak-"))
    os.environ["XDG_RUNTIME_DIR"] = str(folder)
    with (
        RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock")) as server,
        pytest.MonkeyPatch.context() as patch,
        Bus(server.address, name="g1", timeout_s=5.0) as robot,
    ):
        disk = BadDisk(folder, folder / "data", patch)
        with recorded_station(server.address, folder) as station:
            counter = Counter(robot)
            try:
                asked, kills = _kill_between_episodes(station, counter, disk, chance, minutes, slow_s)
            finally:
                counter.stop()
        disk.heal()
    return {**_looked_for(folder / "data", asked), "episodes": len(asked), "kills": kills, "written": counter.written}


def _kill_between_episodes(
    station: RecordedStation, counter: Counter, disk: BadDisk, chance: random.Random, minutes: float, slow_s: float
) -> tuple[dict[str, Asked], int]:
    asked: dict[str, Asked] = {}
    kills, task, end_s = 0, "t0", time.monotonic() + 60.0 * minutes
    station.ask("start", task=task)
    while True:
        first = counter.written
        time.sleep(chance.uniform(0.2, 2.0))
        asked[task] = Asked(first, counter.written)
        if time.monotonic() >= end_s:
            disk.heal()
            station.ask("stop")
            return asked, kills
        time.sleep(max(0.0, LIVED_S - (time.monotonic() - station.supervisor.children["recorder"].started_s)))
        disk.order(f"wait {chance.uniform(0.0, slow_s):.3f}", *CALLS)
        asked[task] = asked[task]._replace(last=counter.written)
        _request(station, "stop", task)
        time.sleep(chance.uniform(0.0, 0.3))
        task = f"t{len(asked)}"
        _request(station, "start", task)
        time.sleep(chance.uniform(0.05, 2.0 * slow_s))
        pid = station.kill()
        kills += 1
        station.wait_for_another(pid)
        wait_until(lambda task=task: _is_recording(station, task), 120.0)  # type: ignore[misc]


def _request(station: RecordedStation, action: str, task: str) -> None:
    """Ask, and wait for no answer."""
    value = {"id": f"{action} {task}", "action": action, "task": task}
    assert station.bus.publish({keys.RECORD: json.dumps(value).encode()})


def _is_recording(station: RecordedStation, task: str) -> bool:
    said = station.bus.read([keys.RECORDER]).get(keys.RECORDER)
    if said is None or said.stamp is None or said.stamp.source.split(".")[1] != str(station.pid):
        return False
    state = station.state()
    return state is not None and state.path is not None and Path(state.path).parent.name == task


def _looked_for(data: Path, asked: dict[str, Asked]) -> dict[str, int]:
    """Count what is there too often, too seldom, or not closed."""
    figures = dict.fromkeys(FAULTS, 0)
    figures["left_open"] = len(left_open(data)) + len(not_begun(data))
    for task, span in asked.items():
        folders = [*data.glob(f"{task}/*/")]
        figures["missing"] += not folders
        figures["twice"] += max(0, len(folders) - 1)
        for folder in folders:
            numbers = [int(message.data) for message in open_episode(folder).messages(["own"])]
            figures["lost"] += len(set(range(span.first, span.last + 1)) - set(numbers))
            figures["twice"] += len(numbers) - len(set(numbers))
            figures["left_open"] += load_manifest(folder).state != "finished"
    figures["not_asked_for"] = len({folder.parent.name for folder in data.glob("*/*/")} - asked.keys())
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.faults.soak_closing", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--slow-flush", type=float, default=1.5, metavar="SECONDS")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    found = soak(chosen.minutes, chosen.slow_flush, chosen.seed)
    sys.stdout.write(json.dumps(found) + "\n")
    sys.exit(any(found[name] for name in FAULTS))
