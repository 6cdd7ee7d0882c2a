"""More comes than the disk takes: images go, signals stay, and of every write it is known where it went."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from station.episode.storage.progress import load_resume_point
from tests.faults.disks import BadDisk
from tests.faults.heavy_cameras import (
    FLUSH_KB,
    FLUSH_TAKES_S,
    PERIOD_S,
    QUEUE_MB,
    Cameras,
    catch_up,
    dropped,
    images_are_accounted_for,
)
from tests.faults.recorded_station import Writers, assert_holds_everything, recorded_station
from tests.waiting import wait_until

OVERLOADED_TAKES_S = 0.5  # a disk of 2 MB a second: images outrun it at a rate that any machine can read and write


@pytest.fixture
def slow_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> BadDisk:
    disk = BadDisk(tmp_path, tmp_path / "data", monkeypatch)
    disk.order(f"wait {FLUSH_TAKES_S}", "fdatasync")
    return disk


def test_on_a_slow_disk_images_are_thinned_out_and_every_command_stays(
    bus_server: BusAddress, tmp_path: Path, slow_disk: BadDisk
) -> None:
    slow_disk.order(f"wait {OVERLOADED_TAKES_S}", "fdatasync")
    with recorded_station(bus_server, tmp_path, queue_mb=QUEUE_MB, flush_kb=FLUSH_KB) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        cameras, writers = Cameras(bus_server, 12.0), Writers(bus_server, PERIOD_S)
        wait_until(lambda: dropped(station) > 300)
        images = cameras.stop()
        slow_disk.heal()
        assert station.ask("mark", label="no more images").ok  # it has heard of all of them by then
        wait_until(lambda: (told := station.events(folder).count("images-dropped")) and told % 2 == 0)
        written = writers.stop()
        ended = station.ask("stop")
    assert_holds_everything(folder, written)
    manifest = images_are_accounted_for(folder, images)
    assert ended.summary["dropped"] == manifest.recorder.dropped > 300
    events = [event for event in manifest.events if event.name.endswith("-dropped")]
    assert {(event.name, event.severity) for event in events} == {("images-dropped", "warning")}
    began, ended_each = events[::2], events[1::2]  # more than once where a busy machine took no image for a while
    assert len(began) == len(ended_each)
    assert sum(event.numbers["dropped"] for event in ended_each) == manifest.recorder.dropped
    assert sum(sum(event.numbers["keys"].values()) for event in ended_each) == manifest.recorder.dropped
    quality = check(open_episode(folder))
    verdicts = {reason.rule: reason.verdict for reason in quality.reasons}
    assert verdicts["dropped-images"] == "usable"
    assert not {"dropped", "lost"} & set(verdicts)
    assert all(stream.lost == 0 for stream in quality.streams)


def test_a_recorder_that_is_killed_while_it_drops_goes_on_counting_where_it_was(
    bus_server: BusAddress, tmp_path: Path, slow_disk: BadDisk
) -> None:
    """It lets 8 MiB wait at the bus, which would keep 256 MiB: a machine that is late cuts no recorder off."""
    slow_disk.order(f"wait {OVERLOADED_TAKES_S}", "fdatasync")
    with recorded_station(bus_server, tmp_path, queue_mb=QUEUE_MB, flush_kb=FLUSH_KB) as station:
        soft_limit_for_an_hour = f"replica {1 << 30} {16 << 20} 3600"
        station.bus.call("CONFIG", "SET", "client-output-buffer-limit", soft_limit_for_an_hour)
        folder = Path(station.ask("start", task="walk").path or "")
        cameras, writers = Cameras(bus_server, 6.0), Writers(bus_server, PERIOD_S)
        wait_until(lambda: (point := load_resume_point(folder)) is not None and point.dropped > 100)
        with cameras.paused():  # what the bus keeps for it has to be enough, however long another takes to come
            pid = station.kill()
            station.wait_for_another(pid)
            wait_until(lambda: (state := station.state()) is not None and state.restarts == 1)
        wait_until(lambda: dropped(station) > 300)
        written, images = writers.stop(), cameras.stop()
        slow_disk.heal()
        station.ask("stop")
    assert [note["by"] for note in load_manifest(folder).recovery] == ["offset"]
    assert "tap-lost" not in station.events(folder)
    assert_holds_everything(folder, written)
    images_are_accounted_for(folder, images)


@pytest.mark.usefixtures("slow_disk")
def test_what_waited_for_a_recorder_that_was_killed_is_read_at_the_pace_of_the_disk_and_nothing_is_dropped(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    dropped, is_behind = catch_up(bus_server, tmp_path)
    assert dropped == 0 or is_behind, "it says so where the machine is too slow"


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
