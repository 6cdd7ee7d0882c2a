"""The recorder's link to the bus starved and overrun, and a bus that takes no writes: what is lost is counted."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from tests.faults import recorded_station as exact
from tests.faults.bus_station import Writers, checked, frozen, kept_bus, lost, missing, of_kind, pause, rules, soon
from tests.faults.recorded_station import BODY, RecordedStation, assert_holds_everything, recorded_station
from tests.waiting import wait_until

BULK = b"x" * 1_000_000


def test_a_recorder_cut_off_for_not_reading_goes_on_from_the_backlog_and_nothing_is_lost(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    admin = Connection(bus_server, timeout_s=5.0)
    with recorded_station(bus_server, tmp_path) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = exact.Writers(bus_server, 0.003)
        station.wait_until_it_records(messages=300)
        admin.call("CONFIG", "SET", "client-output-buffer-limit", "replica 0 65536 1")
        with frozen(station.pid):
            for _ in range(4):
                admin.call("SET", "bulk", BULK)
            wait_until(lambda: _replicas(admin) == 0)
            admin.call("CONFIG", "SET", "client-output-buffer-limit", "replica 0 0 0")
        _wait_for_event(station, folder, "tap-resumed")
        written = writers.stop()
        station.ask("stop", success=True)
    admin.close()
    assert_holds_everything(folder, written)
    quality = checked(folder)
    assert [found.lost for found in of_kind(quality, "tap-cut")] == [0]
    assert (quality.holes, lost(quality), quality.recorder_restarts) == (0, 0, 0)
    assert [m.data for m in open_episode(folder).messages(["bulk"])] == [BULK] * 4


def test_a_backlog_that_is_overrun_leaves_one_hole_with_the_exact_number_of_missing_writes(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    admin = Connection(bus_server, timeout_s=5.0)
    with recorded_station(bus_server, tmp_path) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = exact.Writers(bus_server, 0.003)
        station.wait_until_it_records(messages=300)
        with frozen(station.pid):
            assert admin.call("CLIENT", "KILL", "TYPE", "replica") == 1
            admin.call("CONFIG", "SET", "repl-backlog-size", 16384)
            end = _offset(admin) + 200_000
            wait_until(lambda: _offset(admin) > end)
        _wait_for_event(station, folder, "tap-hole")
        station.wait_until_it_records(messages=1000)
        written = writers.stop()
        ended = station.ask("stop", success=True)
    admin.close()
    assert ended.path == str(folder), "the episode goes on"
    away = missing(folder, BODY, written, "g1")
    assert away == set(range(min(away), max(away) + 1)), "one hole"
    quality = checked(folder)
    (hole,) = of_kind(quality, "hole")
    counted = sum(stream.lost for stream in quality.streams if stream.writer == "g1")
    assert counted == len(away) + len(missing(folder, "own", written, "g1"))
    assert hole.lost == lost(quality) >= counted, "and what the recorder itself said while it was cut off"
    assert "backlog is too small" in hole.reason
    assert quality.verdict == "reject"
    text = next(reason.text for reason in quality.reasons if reason.rule == "holes")
    assert f"{hole.lost} writes lost" in text


def test_a_bus_that_takes_no_writes_is_an_event_and_what_it_refused_is_counted(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    admin = Connection(bus_server, timeout_s=5.0)
    with recorded_station(bus_server, tmp_path) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server)
        station.wait_until_it_records(messages=300)
        admin.call("CONFIG", "SET", "maxmemory", "1")
        wait_until(lambda: not station.bus.publish({"hello": b"1"}))
        assert "refuses writes: OOM" in station.bus.last_error
        pause(1.5)  # longer than a server is silent
        admin.call("CONFIG", "SET", "maxmemory", "0")
        _wait_for_event(station, folder, "bus-refused")
        count, known = writers.stop()
        station.ask("stop", success=True)
    admin.close()
    assert known == len(missing(folder, BODY, count)) + len(missing(folder, "own", count)) > 0
    quality = checked(folder)
    assert {"bus-refused", "lost"} <= rules(quality)
    (refusal,) = of_kind(quality, "bus-refused")
    assert (refusal.told_by, (refusal.lost or 0) > 0, "OOM" in refusal.reason) == (["recorder"], True, True)
    assert (quality.holes, quality.bus_lost) == (0, 0)


@pytest.mark.usefixtures("processes")
def test_a_request_outlives_the_bus_that_it_was_made_on(tmp_path: Path) -> None:
    with kept_bus(tmp_path) as kept, recorded_station(kept.address, tmp_path) as station, ThreadPoolExecutor() as pool:
        folder = Path(station.ask("start", task="walk").path or "")
        station.wait_until_it_records(messages=10)
        with frozen(station.pid):
            os.kill(kept.pid, signal.SIGKILL)
            soon(lambda: kept.restarts == 1 and station.bus.publish({"hello": b"1"}))
            asked = pool.submit(station.ask, "stop", success=True)
            soon(lambda: station.bus.get(keys.RECORD))
            os.kill(kept.pid, signal.SIGKILL)
            soon(lambda: kept.restarts == 2 and station.bus.get(keys.RECORD))
        assert asked.result(60).path == str(folder)
    manifest = load_manifest(folder)
    assert (manifest.recorder.ended_by, manifest.quality_flags.success) == ("stop", True)


def _wait_for_event(station: RecordedStation, folder: Path, name: str) -> None:
    wait_until(lambda: name in [event.name for event in load_manifest(folder).events])
    assert station.supervisor.ended() == {}


def _info(admin: Connection, section: str, field: str) -> int:
    return int(admin.call("INFO", section).split(f"{field}:".encode())[1].split()[0])


def _replicas(admin: Connection) -> int:
    return _info(admin, "replication", "connected_slaves")


def _offset(admin: Connection) -> int:
    return _info(admin, "replication", "master_repl_offset")
