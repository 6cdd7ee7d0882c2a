"""A disk that is full, gone, read-only, slow or silent: the recorder says so, keeps what it has, and comes back."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.reader import open_episode
from station.episode.recorder.remote import ask
from station.episode.storage.claim import is_claimed
from station.episode.storage.manifest import load_manifest
from station.episode.storage.progress import load_resume_point
from station.episode.writing.repair import repair
from station.errors import NotReady, Refused
from tests.faults.disks import CAMERA, BadDisk, camera, small_disk
from tests.faults.recorded_station import BODY, RecordedStation, Writers, assert_holds_everything, recorded_station
from tests.faults.slow_disk import TIMING, robot_beside_a_recorder, ticks_made
from tests.servers.g1_station import LIGHT, Log, logged
from tests.waiting import wait_until

PERIOD_S = 0.003


def reason_of(log: Log, event: str) -> str:
    """Wait for an event; return its reason."""
    wait_until(lambda: log.events(event))
    return str(log.events(event)[-1].detail.get("reason"))


def wait_until_it_has_stopped(station: RecordedStation) -> str:
    """Wait until the recorder has no episode; return why."""
    wait_until(lambda: (found := station.state()) is not None and found.state == "idle")
    state = station.state()
    assert state is not None
    return state.error


def wait_until_free(station: RecordedStation, fits: Callable[[float], bool]) -> None:
    """Wait until the recorder's newest look at the disk has found so much free space [MB]."""
    wait_until(lambda: (found := station.state()) is not None and found.free_mb is not None and fits(found.free_mb))


def record_once_more(station: RecordedStation) -> Path:
    """Record an episode, as if nothing had been; return its folder."""
    folder = Path(station.ask("start", task="again", planned_s=0.1).path or "")
    assert station.ask("stop").ok
    reader = open_episode(folder)
    assert (reader.torn, reader.manifest.state, reader.manifest.recorder.ended_by) == (None, "finished", "stop")
    assert len(list(reader.messages([keys.RECORD]))) == 1
    return folder


def wait_until_it_is_safe(folder: Path, messages: int) -> None:
    """Wait until so many messages of an episode are on the disk."""
    wait_until(lambda: (point := load_resume_point(folder)) is not None and point.messages >= messages)


def assert_holds_the_first(folder: Path, least: int) -> list[int]:
    """An episode that broke off holds what was written until then, at least so many of a key; return their numbers."""
    numbers = [message.sequence for message in open_episode(folder).messages([BODY])]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= least
    return numbers


def test_a_disk_that_fills_up_is_told_early_and_the_episode_ends_whole_before_it_is_full(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    with (
        small_disk(tmp_path, 20) as disk,
        recorded_station(bus_server, disk.path.parent, min_free_mb=8, preroll_s=0) as station,
        logged(bus_server) as log,
    ):
        pid = station.pid
        with camera(bus_server, 2.0) as film:
            wait_until(lambda: (found := station.state()) is not None and (found.minutes_left or 1e3) < 1.0)
            with pytest.raises(
                Refused, match=r"MB free, at least \d+ MB wanted \(60 s at .* and 8 MB that stay free\)"
            ):
                station.ask("start", task="walk")  # a minute, unless told otherwise
            folder = Path(station.ask("start", task="walk", planned_s=2).path or "")
            film.mb_per_s = 0.5  # nothing is told of in the first seconds of an episode
            wait_until(lambda: log.events("disk-low"))
            film.mb_per_s = 2.0
            reason = reason_of(log, "disk-full")
            assert "free some, then start a new episode" in reason
            assert reason in wait_until_it_has_stopped(station)
            low = log.events("disk-low")
            assert 0 <= low[0].detail["minutes_left"] < 1
            assert low[0].detail["episode_id"] == folder.name
            with pytest.raises(Refused, match=r"the last one ended by itself: .* is full but for the 8 MB"):
                station.ask("stop")
            with pytest.raises(Refused, match="MB free, at least"):
                station.ask("start", task="walk", planned_s=2)
        wait_until(lambda: log.events("record-stop"))
        reader = open_episode(folder)
        assert (reader.is_active, reader.torn) == (False, None)
        assert (reader.manifest.state, reader.manifest.recorder.ended_by) == ("finished", "disk-full")
        pictures = [message.sequence for message in reader.messages([CAMERA])]
        assert pictures == list(range(pictures[0], pictures[0] + len(pictures)))
        assert "disk-low" in [event.name for event in reader.manifest.events]
        assert shutil.disk_usage(disk.path).free > 0
        shutil.rmtree(folder)
        wait_until_free(station, lambda free_mb: free_mb > 15)
        record_once_more(station)
        assert station.pid == pid


def test_a_disk_that_somebody_else_fills_leaves_every_flush_and_a_manifest_that_says_so(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    with (
        small_disk(tmp_path, 16) as disk,
        recorded_station(bus_server, disk.path.parent, preroll_s=0) as station,
        logged(bus_server) as log,
    ):
        pid = station.pid
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server, PERIOD_S)
        wait_until_it_is_safe(folder, 500)
        filler = disk.fill()
        assert "No space left on device" in reason_of(log, "record-failed")
        assert "free the disk, then start a new episode" in wait_until_it_has_stopped(station)
        wait_until_free(station, lambda free_mb: free_mb < 0.5)
        with pytest.raises(Refused, match="0 MB free, at least"):
            station.ask("start", task="walk", planned_s=600)
        wait_until(lambda: load_manifest(folder).state == "failed")
        assert "No space left on device" in load_manifest(folder).recorder.ended_by
        numbers = assert_holds_the_first(folder, 100)
        filler.unlink()
        wait_until_free(station, lambda free_mb: free_mb > 1)
        record_once_more(station)
        writers.stop()
        assert repair(folder).state == "repaired"
        assert station.pid == pid
        assert [message.sequence for message in open_episode(folder).messages([BODY])] == numbers


def remove(folder: Path) -> None:
    """``rm -rf``, again where the recorder has just put a file into what was being removed."""
    while folder.exists():
        shutil.rmtree(folder, ignore_errors=True)


def remove_all(station: RecordedStation, _folder: Path) -> None:
    remove(station.data)


def remove_the_episode(_station: RecordedStation, folder: Path) -> None:
    remove(folder)


def rename_all(station: RecordedStation, _folder: Path) -> None:
    station.data.rename(station.data.with_name("elsewhere"))


def remove_the_file(_station: RecordedStation, folder: Path) -> None:
    (folder / "signals.mcap.active").unlink()


@pytest.mark.parametrize("take_away", [remove_all, remove_the_episode, rename_all, remove_the_file])
def test_an_episode_that_is_taken_away_while_it_is_recorded_is_said_at_once(
    bus_server: BusAddress, tmp_path: Path, take_away: Callable[[RecordedStation, Path], None]
) -> None:
    with recorded_station(bus_server, tmp_path, preroll_s=0) as station, logged(bus_server) as log:
        pid = station.pid
        folder = Path(station.ask("start", task="walk").path or "")
        take_away(station, folder)
        assert "it was removed, renamed or unmounted while it was written" in reason_of(log, "record-failed")
        wait_until_it_has_stopped(station)
        with pytest.raises(Refused, match=r"the last one ended by itself: .* No such file"):
            station.ask("stop")
        record_once_more(station)
        assert station.pid == pid
        assert is_claimed(station.data)
        assert [path for path in station.data.glob("walk/*") if not path.is_dir()] == []


def test_a_disk_that_is_unmounted_is_not_replaced_by_the_folder_beneath(bus_server: BusAddress, tmp_path: Path) -> None:
    with (
        small_disk(tmp_path, 16) as disk,
        recorded_station(bus_server, disk.path.parent, preroll_s=0) as station,
        logged(bus_server) as log,
    ):
        station.ask("start", task="walk")
        disk.unmount()
        assert "it was removed, renamed or unmounted" in reason_of(log, "record-failed")
        wait_until(lambda: (found := station.state()) is not None and found.free_mb is None)
        with pytest.raises(Refused, match=f"no disk is mounted at {disk.path} any more; mount it"):
            station.ask("start", task="walk")
        assert list(disk.path.iterdir()) == []
        disk.mount()
        wait_until_free(station, lambda free_mb: free_mb > 1)
        assert record_once_more(station).is_relative_to(disk.path)


def test_a_disk_that_turns_read_only_ends_the_episode_and_refuses_the_next_until_it_can_be_written(
    bus_server: BusAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = BadDisk(tmp_path, tmp_path / "data", monkeypatch)
    with recorded_station(bus_server, tmp_path, preroll_s=0) as station, logged(bus_server) as log:
        pid = station.pid
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server, PERIOD_S)
        wait_until_it_is_safe(folder, 500)
        disk.order("fail EROFS", "write", "open", "mkdir", "replace", "unlink")
        assert "Read-only file system" in reason_of(log, "record-failed")
        assert "make the disk writable, then start a new episode" in wait_until_it_has_stopped(station)
        with pytest.raises(Refused, match="cannot make an episode in it: Read-only file system"):
            station.ask("start", task="walk")
        disk.heal()
        writers.stop()
        assert_holds_the_first(folder, 100)
        record_once_more(station)
        assert station.pid == pid


def test_a_disk_that_hangs_holds_up_neither_the_reader_of_the_bus_nor_a_single_write(
    bus_server: BusAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = BadDisk(tmp_path, tmp_path / "data", monkeypatch)
    with recorded_station(bus_server, tmp_path) as station, logged(bus_server) as log:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server, PERIOD_S)
        station.wait_until_it_records(messages=300)
        disk.order("hang", "fdatasync", "fsync", "statvfs")
        wait_until(lambda: log.events("disk-stuck"))
        state = station.state()
        assert state is not None
        assert state.queued > 1000  # read from the bus, while nothing could be written
        disk.heal()
        wait_until(lambda: log.events("disk-answers"))
        wait_until(lambda: (found := station.state()) is not None and (found.lag_p99_ms or 0.0) > 1000)
        station.wait_until_it_records(messages=state.messages + state.queued)
        written = writers.stop()
        ended = station.ask("stop")
    assert ended.summary["dropped"] == 0
    assert_holds_everything(folder, written)


def test_who_stops_an_episode_on_a_disk_that_hangs_is_told_that_the_recorder_lives_and_it_stops_later(
    bus_server: BusAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = BadDisk(tmp_path, tmp_path / "data", monkeypatch)
    with recorded_station(bus_server, tmp_path) as station, Bus(bus_server, name="operator", timeout_s=5.0) as line:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server, PERIOD_S)
        station.wait_until_it_records(messages=300)
        disk.order("hang", "fdatasync", "fsync", "statvfs")
        written = writers.stop()
        with pytest.raises(NotReady, match=r"^record stop: '\w+' has not answered within 3 s and is alive: its disk"):
            ask(line, "stop", timeout_s=3.0)
        disk.heal()
        assert wait_until_it_has_stopped(station) == ""
    assert_holds_everything(folder, written)


def test_control_goes_on_and_every_step_is_recorded_while_every_sync_of_the_disk_takes_200_ms(
    bus_server: BusAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = BadDisk(tmp_path, tmp_path / "data", monkeypatch)
    with robot_beside_a_recorder(bus_server, tmp_path, *LIGHT) as (log, station):
        folder = Path(station.ask("start", task="walk").path or "")
        first = len(log.values(TIMING))
        disk.order("wait 0.2", "fdatasync", "fsync")
        ticks_made(log, 50)
        disk.heal()
        last = len(log.values(TIMING))
        ended = station.ask("stop")
    assert (ended.summary["lost"], ended.summary["dropped"], ended.summary["holes"]) == (0, 0, 0)
    recorded = {json.loads(message.data)[0] for message in open_episode(folder).messages([TIMING])}
    assert {json.loads(value)[0] for value in log.values(TIMING)[first:last]} <= recorded


def test_a_recorder_that_starts_on_a_full_disk_waits_for_space(bus_server: BusAddress, tmp_path: Path) -> None:
    with small_disk(tmp_path, 4) as disk:
        filler = disk.fill()
        with recorded_station(bus_server, disk.path.parent, preroll_s=0) as station:
            with pytest.raises(Refused, match=r"No space left on device|MB free, at least"):
                station.ask("start", task="walk", planned_s=0)
            assert [path.name for path in disk.path.glob("walk/*")] == []
            filler.unlink()
            wait_until_free(station, lambda free_mb: free_mb > 1)
            record_once_more(station)
