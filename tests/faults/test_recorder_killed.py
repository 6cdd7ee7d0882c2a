"""A recorder that is killed with -9, at any moment and any number of times in one episode, loses nothing."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from tests.cli.running import COMMANDS_ONLY, SHORT, are_gone, new_home
from tests.faults.killed_recorder import (
    PERIOD_S,
    be_away,
    kill_at_random_moments,
    kill_while_it_closes,
    kill_while_it_recovers,
    kill_while_it_starts,
)
from tests.faults.recorded_station import BODY, Writers, assert_holds_everything, recorded_station
from tests.waiting import wait_until

RECORDED = ("--yes", "--record", "--task", "t", "--set", "motion.loop=true", *SHORT)


def test_killed_at_random_moments_it_holds_every_write_once_in_order(bus_server: BusAddress, tmp_path: Path) -> None:
    folder = kill_at_random_moments(bus_server, tmp_path, random.Random(1), kills=2)
    rerun = Path(sys.executable).with_name("rerun")
    for name in ("signals.mcap", "cameras.mcap"):
        checked = subprocess.run([rerun, "mcap", "check", folder / name], capture_output=True, check=False)
        assert checked.returncode == 0, checked.stderr


def test_a_recorder_that_was_away_leaves_no_silence_and_no_burst_in_the_times(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    folder = be_away(bus_server, tmp_path)
    (note,) = load_manifest(folder).recovery
    messages = list(open_episode(folder).messages([BODY], stamps=True))
    logged_ns = np.array([message.log_ns for message in messages])
    written_ns = np.array([int((message.stamp or b"").split()[1]) for message in messages])
    as_written = np.diff(logged_ns) == np.diff(written_ns)
    assert note["away_s"] > 0
    assert as_written.sum() > 10, "what waited at the bus has the times at which it was written"


def test_in_station_up_a_killed_recorder_comes_back_and_the_station_goes_on(processes: None) -> None:
    with new_home() as home, home.running("up", COMMANDS_ONLY, *RECORDED) as station:
        station.wait_for("· motion: motion-start")
        first = home.pids()["recorder"]
        os.kill(first, signal.SIGKILL)
        station.wait_for("recorder-resumed")
        assert "supervisor: server-restarted server=recorder reason=was killed by SIGKILL" in station.text
        wait_until(lambda: home.health()["recorder"].detail.get("restarts") == 1)
        assert "restarts 1" in home.run("status").stdout
        station.interrupt()
        code, out = station.finish()
        assert code == 0, station.text
        shown = home.json("check", out.strip())
        assert sum(stream["lost"] for stream in shown["streams"]) == 0
        assert (shown["recorder_restarts"], shown["holes"], shown["is_finished"]) == (1, 0, True)


def test_a_station_that_starts_anew_leaves_the_old_episode_alone_and_offers_to_repair_it(processes: None) -> None:
    with new_home() as home:
        with home.running("up", COMMANDS_ONLY, *RECORDED) as station:
            station.wait_for("· motion: motion-start")
            pids = home.pids()
            os.kill(pids["recorder"], signal.SIGSTOP)  # so that it cannot close its episode
            station.process.kill()
            os.kill(pids["recorder"], signal.SIGKILL)
            wait_until(lambda: are_gone(list(pids.values())))
        wait_until(lambda: not home.bus_is_there())
        with home.running("up", COMMANDS_ONLY, *RECORDED) as station:
            station.wait_for("· motion: motion-start")
            assert "was left open by a recorder that died; repair with: station episodes repair --all" in station.text
            station.interrupt()
            code, _ = station.finish()
        assert code == 0, station.text
        done = home.run("episodes", "repair", "--all")
        assert done.returncode == 0, done.stderr
        assert " repaired: " in done.stdout
        states = [row["state"] for row in home.json("episodes", "list")]
        assert states == ["finished", "finished"]


def test_killed_again_and_again_while_it_recovers(bus_server: BusAddress, tmp_path: Path) -> None:
    kill_while_it_recovers(bus_server, tmp_path, random.Random(2), kills=2)


def test_killed_right_after_the_start_was_asked_for(bus_server: BusAddress, tmp_path: Path) -> None:
    kill_while_it_starts(bus_server, tmp_path, random.Random(0))


def test_killed_while_it_closes_the_episode(bus_server: BusAddress, tmp_path: Path) -> None:
    kill_while_it_closes(bus_server, tmp_path, random.Random(0))


def test_what_was_asked_while_it_was_down_is_done(bus_server: BusAddress, tmp_path: Path) -> None:
    with recorded_station(bus_server, tmp_path) as station, ThreadPoolExecutor() as pool:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server, PERIOD_S)
        station.wait_until_it_records(messages=100)
        pid = station.kill()
        marked = pool.submit(station.ask, "mark", label="here")
        assert marked.result().ok
        station.wait_for_another(pid)
        station.wait_until_it_records()
        written = writers.stop()
        pid = station.kill()
        assert station.ask("discard", label="no good").path == str(folder)
    assert_holds_everything(folder, written)
    manifest = load_manifest(folder)
    assert [mark.label for mark in manifest.marks] == ["here", "discarded: no good"]
    assert (manifest.quality_flags.discarded, manifest.recorder.ended_by) == (True, "discard")


def test_a_server_that_no_longer_has_it_leaves_a_hole_that_is_measured_and_check_fails(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    with recorded_station(bus_server, tmp_path) as station:
        admin = Connection(bus_server, timeout_s=5.0)
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server, PERIOD_S)
        station.wait_until_it_records(messages=500)
        admin.call("CONFIG", "SET", "repl-backlog-size", 16384)
        pid = station.kill()
        for _ in range(5):
            admin.call("SET", "large", b"x" * 20_000)  # more than the backlog holds
        station.wait_for_another(pid)
        station.wait_until_it_records(messages=1000)
        written = writers.stop()
        admin.close()
        station.ask("stop")
    reader = open_episode(folder)
    numbers = [message.sequence for message in reader.messages([BODY])]
    missing = sorted(set(range(1, written + 1)) - set(numbers))
    assert missing, "the backlog was meant to overrun"
    assert len(set(numbers)) == len(numbers)
    (hole,) = reader.manifest.holes
    assert hole.lost is not None
    assert hole.lost >= 2 * len(missing)  # both native keys, and what servers say of themselves
    assert "no longer had" in hole.reason
    assert [note["by"] for note in reader.manifest.recovery] == ["hole"]
    quality = check(reader)
    assert quality.verdict == "reject"
    assert {"lost", "holes"} <= {reason.rule for reason in quality.reasons}
