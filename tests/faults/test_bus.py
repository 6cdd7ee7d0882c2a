"""The bus frozen, killed and restarted in the middle of an episode: the robot stays safe, and `check` tells of it."""

from __future__ import annotations

import os
import signal
from itertools import pairwise
from pathlib import Path
from tempfile import mkdtemp

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.control.gate import GateConfig
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from station.life import estop
from tests.bus.proxy import Proxy
from tests.cli.running import COMMANDS_ONLY, SHORT, new_home
from tests.faults.bus_station import (
    SERVERS,
    Writers,
    checked,
    frozen,
    gate_states,
    kept_bus,
    lost,
    missing,
    of_kind,
    pause,
    pid_of,
    robot_station,
    rules,
    soon,
)
from tests.faults.recorded_station import recorded_station
from tests.lateness import TooLate, Waits, excuse, in_time
from tests.servers.g1_station import LIGHT, G1Process, Log, StockCommander, logged
from tests.waiting import wait_until

HOLDS_S = GateConfig().return_after_s - GateConfig().hold_after_s
TOGETHER_S = 0.5  # what servers tell within it is one interruption


def test_frozen_for_two_seconds_it_costs_no_write_and_the_robot_holds_stands_and_comes_back(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    in_time(lambda: freeze_the_bus(bus_server, Path(mkdtemp(dir=tmp_path))))


def freeze_the_bus(address: BusAddress, place: Path) -> None:
    with Waits.watched() as waits, robot_station(address, place) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        station.wait_until_it_records(messages=200)
        with frozen(pid_of(address)):
            pause(2.0)
        soon(lambda: station.gate() == "tracking")
        wait_until(lambda: set(station.told(folder, "bus-silent")) == set(SERVERS))
        station.ask("stop", success=True)
        waits.seconds()
    reader = open_episode(folder)
    quality = check(reader)
    assert lost(quality) == 0
    silence = max(of_kind(quality, "bus-silent"), key=lambda found: found.seconds or 0)
    assert 1.5 < (silence.seconds or 0) < 20
    assert silence.told_by == SERVERS
    assert (of_kind(quality, "hole"), of_kind(quality, "bus-lost")) == ([], [])
    assert "bus-silent" in rules(quality)
    states = gate_states(reader)
    expect_held(list(pairwise(states)), waits)
    back = states[states.index("returning") :]
    assert "tracking" in back[back.index("entering") :]
    assert quality.falls == 0


def expect_held(changes: list[tuple[str, str]], waits: Waits) -> None:
    """It held before it returned; or no step was made so soon, because somebody had to wait."""
    if ("tracking", "returning") in changes and ("holding", "returning") not in changes:
        raise TooLate(f"a step that holds: {changes}", HOLDS_S, waits.longest_s)
    assert ("holding", "returning") in changes


def test_killed_again_and_again_it_is_back_at_once_and_a_stop_stays_latched_though_the_bus_forgot_it(
    tmp_path: Path,
) -> None:
    with Waits.watched() as waits, kept_bus(tmp_path) as kept, robot_station(kept.address, tmp_path) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        station.wait_until_it_records(messages=200)
        os.kill(kept.pid, signal.SIGKILL)
        soon(lambda: kept.restarts == 1 and station.gate() == "tracking")
        soon(lambda: station.bus.get(keys.server_config("g1")) and station.bus.get(keys.server_config("motion")))
        wait_until(lambda: station.told(folder, "bus-back") == SERVERS)
        station.bus.publish({keys.ESTOP: b'{"stop": true}'})
        wait_until(lambda: station.gate() == "stopped")
        os.kill(kept.pid, signal.SIGKILL)
        soon(lambda: kept.restarts == 2 and station.gate() == "stopped")
        wait_until(lambda: len(station.told(folder, "bus-back")) == 2 * len(SERVERS))
        soon(lambda: estop.read(station.bus.get(keys.ESTOP) or b"").stop)
        assert station.gate() == "stopped"
        station.bus.publish({keys.ESTOP: b'{"stop": false}'})
        wait_until(lambda: station.gate() == "tracking")
        ended = station.ask("stop")
        waits.seconds()
    assert ended.path == str(folder)
    assert gate_states(open_episode(folder)).count("stopped") == 1, "it stays so until it is released"
    quality = checked(folder)
    assert quality.verdict == "reject"
    assert {"holes", "bus-lost", "lost"} <= rules(quality)
    losses, holes = of_kind(quality, "bus-lost"), of_kind(quality, "hole")
    assert sorted(name for loss in losses for name in loss.told_by) == sorted(2 * SERVERS)
    if len(losses) > 2:
        excuse(TooLate(f"two losses were told as {len(losses)}", TOGETHER_S / 2, waits.longest_s))
    assert all(hole.lost and "the bus was restarted" in hole.reason for hole in holes)
    assert sum(hole.lost or 0 for hole in holes) == lost(quality)
    assert len(holes) == len(load_manifest(folder).holes) == 2
    assert set(load_manifest(folder).servers) >= {"g1", "motion"}


def test_connections_that_are_cut_come_back_at_once_and_each_cut_is_told_of(
    bus_server: BusAddress, tmp_path: Path
) -> None:
    with Waits.watched() as waits, robot_station(bus_server, tmp_path) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        for kind, event, told_by in (
            ("replica", "tap-resumed", ["recorder"]),
            ("pubsub", "watch-back", ["g1", "motion"]),
            ("normal", "bus-back", SERVERS),
        ):
            assert _kill_clients(bus_server, kind) >= 1
            wait_until(lambda event=event, told_by=told_by: station.told(folder, event) == told_by)  # type: ignore[misc]
        soon(lambda: station.gate() == "tracking")
        soon(lambda: station.bus.publish({"hello": b"1"}))
        station.ask("stop", success=True)
        waits.seconds()
    quality = checked(folder)
    told = [(found.kind, found.told_by) for found in quality.interruptions if found.kind != "bus-silent"]
    assert told[:2] == [("tap-cut", ["recorder"]), ("watch-cut", ["g1", "motion"])]
    losses = of_kind(quality, "bus-lost")
    assert len(told) == 2 + len(losses)
    assert sorted(name for found in losses for name in found.told_by) == SERVERS
    if len(losses) > 1:  # who notices half a second after the others tells of one of its own
        excuse(TooLate(f"one cut was told as {len(losses)}", TOGETHER_S / 2, waits.longest_s))
    assert of_kind(quality, "tap-cut")[0].lost == 0
    known = sum(found.lost or 0 for found in losses)
    assert 0 < lost(quality) <= known, "nothing is missing but what cut writers know to be lost"
    assert quality.holes == 0


def test_killed_for_good_it_ends_the_episode_and_one_that_comes_later_is_recorded_again(tmp_path: Path) -> None:
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


def test_in_station_up_a_killed_bus_is_started_again_and_the_station_goes_on() -> None:
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
    assert (shown["verdict"], shown["holes"], shown["bus_lost"], shown["is_finished"]) == ("reject", 1, 1, True)
    assert {"bus-lost", "hole"} <= {found["kind"] for found in shown["interruptions"]}
    assert "bus: lost once" in text
    assert "1 hole in the recording" in text


def test_a_stop_that_was_pressed_while_the_robot_could_not_hear_is_obeyed_and_a_reset_is_not(
    bus_server: BusAddress,
) -> None:
    with (
        Proxy(bus_server) as network,
        Bus(bus_server, name="operator", timeout_s=5.0) as operator,
        logged(bus_server) as log,
        G1Process(network.address, *LIGHT),
        StockCommander(bus_server),
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        _unheard(network, operator, log, b'{"stop": true}')
        wait_until(lambda: log.gate()["state"] == "stopped")
        _unheard(network, operator, log, b'{"stop": false}')
        seen = len(log.states())
        wait_until(lambda: len(log.states()) > seen + 20)
        assert set(log.states()[seen:]) == {"stopped"}
        operator.publish({keys.ESTOP: b'{"stop": false}'})
        wait_until(lambda: log.gate()["state"] == "tracking")


def test_a_stop_is_obeyed_though_somebody_has_switched_off_what_tells_the_robot_of_it(bus_server: BusAddress) -> None:
    """The usual idiom of who wants to hear of expired keys alone, right before the stop; nothing is written again."""
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *LIGHT),
        StockCommander(bus_server),
        Bus(bus_server, name="operator", timeout_s=5.0) as operator,
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        operator.call("CONFIG", "SET", "notify-keyspace-events", "Ex")
        operator.call("SET", keys.ESTOP, b'{"stop": true}')
        wait_until(lambda: log.gate()["state"] == "stopped")
        told = log.wait_for("watch-back")
        assert "some client set notify-keyspace-events to 'xE'" in told.detail["reason"]
        operator.publish({keys.ESTOP: b'{"stop": false}'})
        wait_until(lambda: log.gate()["state"] == "tracking")


def _unheard(network: Proxy, operator: Bus, log: Log, request: bytes) -> None:
    """Write a request while the robot is cut off, and wait until it is back."""
    told = len(log.events("bus-back"))
    network.cut()
    operator.publish({keys.ESTOP: request})
    network.mend()
    wait_until(lambda: len(log.events("bus-back")) > told)


def _kill_clients(address: BusAddress, kind: str) -> int:
    admin = Connection(address, timeout_s=5.0)
    try:
        return int(admin.call("CLIENT", "KILL", "TYPE", kind, "SKIPME", "yes"))
    finally:
        admin.close()
