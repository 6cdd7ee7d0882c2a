"""A recorder that is killed with -9 at some moment of an episode; what is asked of it holds whenever that is."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random

from station.bus.address import BusAddress
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from tests.faults.recorded_station import (
    BODY,
    CAMERA,
    Writers,
    assert_holds_every_picture,
    assert_holds_everything,
    recorded_station,
)
from tests.waiting import wait_until

PERIOD_S = 0.003


def kill_at_random_moments(address: BusAddress, place: Path, random: Random, kills: int) -> Path:
    """Kill it while it records; return the episode."""
    with recorded_station(address, place) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(address, PERIOD_S, films=True)
        for _ in range(kills):
            station.wait_until_it_records()
            time.sleep(random.uniform(0.0, 1.0))  # any moment will do, which is the point
            pid = station.kill()
            station.wait_for_another(pid)
        written = writers.stop()
        ended = station.ask("stop", success=True)
    assert ended.path == str(folder)
    assert_holds_everything(folder, written)
    assert_holds_every_picture(folder, writers.pictures)
    manifest = load_manifest(folder)
    assert (manifest.state, manifest.recorder.ended_by, manifest.holes) == ("finished", "stop", [])
    assert manifest.recorder.restarts == kills
    assert [note["by"] for note in manifest.recovery] == ["offset"] * kills
    return folder


def be_away(address: BusAddress, place: Path) -> Path:
    """Kill it once while others write; return the episode."""
    with recorded_station(address, place) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(address, PERIOD_S)
        station.wait_until_it_records(messages=300)
        pid = station.kill()
        station.wait_for_another(pid)
        station.wait_until_it_records()
        writers.stop()
        station.ask("stop")
    return folder


def kill_while_it_recovers(address: BusAddress, place: Path, random: Random, kills: int) -> Path:
    """Kill it while it takes up the episode of the one that was killed before it; return the episode."""
    with recorded_station(address, place) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(address, PERIOD_S, films=True)
        station.wait_until_it_records(messages=500)
        for _ in range(kills):
            pid = station.kill()
            station.wait_for_another(pid)
            time.sleep(random.uniform(0.0, 1.2))  # it loads for most of this, then takes the episode up
        station.wait_until_it_records()
        written = writers.stop()
        station.ask("stop")
    assert_holds_everything(folder, written)
    assert_holds_every_picture(folder, writers.pictures)
    assert load_manifest(folder).holes == []
    return folder


def kill_while_it_starts(address: BusAddress, place: Path, random: Random) -> Path:
    """Kill it right after a start was asked for; return the episode."""
    with recorded_station(address, place) as station, ThreadPoolExecutor() as pool:
        writers = Writers(address, PERIOD_S)
        wait_until(lambda: station.bus.get(BODY) is not None)
        asked = pool.submit(station.ask, "start", task="walk")
        time.sleep(random.uniform(0.0, 0.04))
        pid = station.kill()
        station.wait_for_another(pid)
        folder = Path(asked.result().path or "")
        written = writers.stop()
        ended = station.ask("stop")
    assert ended.path == str(folder)
    numbers = [message.sequence for message in open_episode(folder).messages([BODY])]
    assert numbers == list(range(numbers[0], written + 1))
    manifest = load_manifest(folder)
    assert (manifest.state, sum(stream.lost + stream.repeated for stream in manifest.streams)) == ("finished", 0)
    return folder


def kill_while_it_closes(address: BusAddress, place: Path, random: Random) -> Path:
    """Kill it right after a stop was asked for; return the episode."""
    with recorded_station(address, place) as station, ThreadPoolExecutor() as pool:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(address, PERIOD_S, films=True)
        wait_until(lambda: station.bus.get(CAMERA) is not None)
        time.sleep(random.uniform(0.0, 0.6))
        written = writers.stop()
        asked = pool.submit(station.ask, "stop", success=True)
        time.sleep(random.uniform(0.0, 0.06))
        pid = station.kill()
        station.wait_for_another(pid)
        ended = asked.result()
    assert (ended.path, ended.summary["lost"]) == (str(folder), 0)
    assert_holds_everything(folder, written)
    assert_holds_every_picture(folder, writers.pictures)
    manifest = load_manifest(folder)
    assert (manifest.state, manifest.recorder.ended_by) == ("finished", "stop")
    assert manifest.quality_flags.success is True
    assert sorted(file.name for file in folder.iterdir()) == ["cameras.mcap", "manifest.yaml", "signals.mcap"]
    return folder
