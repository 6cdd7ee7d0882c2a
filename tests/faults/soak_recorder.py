"""``python -m tests.faults.soak_recorder --minutes 60``: a recorder killed every few seconds, under load, for long.

Each minute is an episode of its own; after each, every write and every picture is looked for in its files. Prints one
JSON line at the end: kills survived, messages written, lost, duplicated, and the longest time away.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
import time
from pathlib import Path

from station.bus.redis_server import RedisServer, ServerOptions
from station.episode.storage.manifest import Manifest, load_manifest
from tests.faults.recorded_station import (
    RecordedStation,
    Writers,
    assert_holds_every_picture,
    assert_holds_everything,
    recorded_station,
)

EPISODE_S = 60.0
LIVED_S = 3.1  # a recorder that dies younger, again and again, is given up on purpose


def soak(minutes: float, *, kill_every_s: float, period_s: float, seed: int) -> dict[str, float]:
    """Record and kill for some minutes; return the figures.

    Raises:
        AssertionError: a write is missing, twice, out of order, or not byte for byte what was written.
    """
    moments = random.Random(seed)
    figures = dict.fromkeys(("episodes", "kills", "written", "lost", "duplicated", "holes", "longest_away_s"), 0.0)
    folder = Path(tempfile.mkdtemp(prefix="soak-"))
    os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"] = str(folder)
    server = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
    with server, recorded_station(server.address, folder) as station:
        end = time.monotonic() + 60.0 * minutes
        while time.monotonic() < end:
            episode = Path(station.ask("start", task="soak").path or "")
            writers = Writers(server.address, period_s, films=True)
            figures["kills"] += _kill_for(station, EPISODE_S, kill_every_s, moments)
            station.wait_until_it_records()
            count = writers.stop()
            station.ask("stop")
            assert_holds_everything(episode, count)
            assert_holds_every_picture(episode, writers.pictures)
            _add(figures, load_manifest(episode), 3 * count + writers.pictures)
            for file in episode.glob("*.mcap"):
                file.unlink()
    return figures


def _kill_for(station: RecordedStation, seconds: float, every_s: float, moments: random.Random) -> int:
    kills, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(moments.uniform(0.0, 2.0 * every_s))
        time.sleep(max(0.0, LIVED_S - (time.monotonic() - station.supervisor.children["recorder"].started_s)))
        pid = station.kill()
        station.wait_for_another(pid)
        kills += 1
    return kills


def _add(figures: dict[str, float], manifest: Manifest, written: int) -> None:
    figures["episodes"] += 1
    figures["written"] += written
    figures["lost"] += sum(stream.lost for stream in manifest.streams)
    figures["duplicated"] += sum(stream.repeated for stream in manifest.streams)
    figures["holes"] += len(manifest.holes)
    figures["longest_away_s"] = max([figures["longest_away_s"], *(note["away_s"] for note in manifest.recovery)])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--kill-every", type=float, default=10.0, metavar="SECONDS")
    parser.add_argument(
        "--period", type=float, default=0.0007, metavar="SECONDS", help="between rounds of three writes"
    )
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    found = soak(chosen.minutes, kill_every_s=chosen.kill_every, period_s=chosen.period, seed=chosen.seed)
    sys.stdout.write(json.dumps(found) + "\n")
