"""The bus frozen, killed and restarted in the middle of an episode: the robot stays safe, and `check` tells of it."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from station.bus.address import BusAddress
from station.bus.redis_server import RedisServer, ServerOptions
from station.control.gate import GateConfig
from station.episode.storage.manifest import load_manifest
from tests.cli.running import COMMANDS_ONLY, SHORT, new_home
from tests.faults.bus_station import (
    Writers,
    checked,
    missing,
    of_kind,
    pid_of,
    rules,
    soon,
)
from tests.faults.bus_trials import cut_every_connection, freeze_the_bus, kill_the_bus_twice
from tests.faults.recorded_station import recorded_station
from tests.waiting import wait_until


def test_frozen_for_a_while_it_costs_no_write_and_the_robot_holds_stands_and_comes_back(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    patient = GateConfig(hold_after_s=0.5, return_after_s=1.5)
    changes = freeze_the_bus(bus_server, tmp_path, 3.0, gate=patient)
    assert ("holding", "returning") in changes


def test_killed_again_and_again_it_is_back_and_a_stop_stays_latched_though_the_bus_forgot_it(
    processes: None, tmp_path: Path
) -> None:
    kill_the_bus_twice(tmp_path)


def test_connections_that_are_cut_come_back_and_each_cut_is_told_of(bus_server: BusAddress, tmp_path: Path) -> None:
    cut_every_connection(bus_server, tmp_path)


def test_killed_for_good_it_ends_the_episode_and_one_that_comes_later_is_recorded_again(
    processes: None, tmp_path: Path
) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    with RedisServer.start(options) as first, recorded_station(first.address, tmp_path, resume_s=0.5) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(first.address)
        station.wait_until_it_records(messages=100)
        os.kill(first.pid, signal.SIGKILL)
        wait_until(lambda: load_manifest(folder).state == "finished")
        with RedisServer.start(options):
            soon(lambda: station.bus.publish({"hello": b"1"}))
            again = Path(station.ask("start", task="walk").path or "")
            station.wait_until_it_records(messages=100)
            count, known = writers.stop()
            station.ask("stop")
            assert station.supervisor.ended() == {}
    assert load_manifest(folder).recorder.ended_by == "bus-lost"
    assert of_kind(checked(folder), "bus-lost")[-1].seconds is None
    assert "bus-lost" in rules(checked(folder))
    both = missing(folder, "own", count) & missing(again, "own", count)
    assert both
    assert known >= 2, "the writer counts what no server took"
    assert (load_manifest(again).state, load_manifest(again).holes) == ("finished", [])


def test_in_station_up_a_killed_bus_is_started_again_and_the_station_goes_on(processes: None) -> None:
    with new_home() as home, home.running("up", COMMANDS_ONLY, "--yes", "--record", "--task", "t", "--set",
                                          "motion.loop=true", *SHORT) as station:  # fmt: skip
        station.wait_for("· motion: motion-start")
        os.kill(pid_of(home.bus), signal.SIGKILL)
        station.wait_for("bus server was killed by signal 9; started again")
        station.wait_for("recorder: tap-hole")
        station.wait_for("motion: bus-back")
        station.interrupt()
        code, out = station.finish()
        assert code == 0, station.text
        shown = home.json("check", out.strip())
        text = home.run("check", out.strip()).stdout
    assert (shown["verdict"], shown["holes"], shown["is_finished"]) == ("reject", 1, True)
    assert {"bus-lost", "hole"} <= {found["kind"] for found in shown["interruptions"]}
    losses = [found for found in shown["interruptions"] if found["kind"] == "bus-lost"]
    tellers = [name for found in losses for name in found["told_by"]]
    assert len(tellers) == len(set(tellers)), "once by each server, and where one was late not by all together"
    assert shown["bus_lost"] == len(losses)
    assert "bus: lost" in text
    assert "1 hole in the recording" in text
