"""The bus frozen, killed and cut in the middle of an episode: what `check` finds in it."""

from __future__ import annotations

import os
import signal
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from station.life import estop
from station.life.stop_file import StopFile
from tests.faults.bus_station import (
    SERVERS,
    RobotStation,
    checked,
    frozen,
    gate_states,
    kept_bus,
    lost,
    of_kind,
    pause,
    pid_of,
    robot_station,
    rules,
    soon,
)
from tests.waiting import wait_until


def freeze_the_bus(address: BusAddress, place: Path, seconds: float, **g1: Any) -> list[tuple[str, str]]:
    """Freeze the bus while a robot moves; return the changes of its gate.

    Args:
        address: Of the bus.
        place: For everything that is written.
        seconds: For which it is frozen; shorter than what is given up [s].
        g1: Settings of the robot's server.
    """
    with robot_station(address, place, g1=g1) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        station.wait_until_it_records(messages=200)
        with frozen(pid_of(address)):
            pause(seconds)
            known = len(station.log("g1"))
        wait_until(lambda: "to=tracking" in station.log("g1")[known:])
        wait_until(lambda: set(station.told(folder, "bus-silent")) == set(SERVERS))
        soon(lambda: station.gate() == "tracking")  # and by now the bus has all that was kept from it
        station.ask("stop", success=True)
    reader = open_episode(folder)
    quality = check(reader)
    assert lost(quality) == 0
    silence = max(of_kind(quality, "bus-silent"), key=lambda found: found.seconds or 0)
    assert (silence.seconds or 0) > 0.75 * seconds
    assert silence.told_by == SERVERS
    assert (of_kind(quality, "hole"), of_kind(quality, "bus-lost")) == ([], [])
    assert "bus-silent" in rules(quality)
    states = gate_states(reader)
    back = states[states.index("returning") :]
    assert "tracking" in back[back.index("entering") :]
    assert quality.falls == 0
    return list(pairwise(states))


def kill_the_bus_twice(place: Path) -> Quality:
    """Kill a bus that is kept, and kill it again while a stop is latched; return what `check` finds."""
    told_by = Counter([*SERVERS, "g1", "recorder"])  # the second time the motion has ended, by the stop
    with kept_bus(place) as kept, robot_station(kept.address, place) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        station.wait_until_it_records(messages=200)
        os.kill(kept.pid, signal.SIGKILL)
        soon(lambda: kept.restarts == 1 and station.gate() == "tracking")
        soon(lambda: station.bus.get(keys.server_config("g1")) and station.bus.get(keys.server_config("motion")))
        wait_until(lambda: says_bus_back(station) == Counter(SERVERS))
        station.bus.publish({keys.ESTOP: b'{"stop": true}'})
        wait_until(lambda: station.gate() == "stopped" and "motion" in station.supervisor.ended())
        os.kill(kept.pid, signal.SIGKILL)
        soon(lambda: kept.restarts == 2 and station.gate() == "stopped")
        wait_until(lambda: says_bus_back(station) == told_by)
        soon(lambda: estop.read(station.bus.get(keys.ESTOP) or b"").stop)
        assert station.gate() == "stopped"
        station.bus.publish({keys.ESTOP: b'{"stop": false}'})
        wait_until(lambda: station.gate() == "waiting")
        wait_until(lambda: StopFile(kept.address).read() is None)  # a motion that starts reads it
        station.supervisor.start_again("motion")
        wait_until(lambda: station.gate() == "tracking")
        ended = station.ask("stop")
    assert ended.path == str(folder)
    assert gate_states(open_episode(folder)).count("stopped") == 1, "it stays so until it is released"
    quality = checked(folder)
    assert quality.verdict == "reject"
    assert {"holes", "bus-lost", "lost"} <= rules(quality)
    losses, holes = of_kind(quality, "bus-lost"), of_kind(quality, "hole")
    # A recorder that hears the bus again later than the others misses what they say of the loss.
    assert Counter(name for loss in losses for name in loss.told_by) <= told_by
    assert all(hole.lost and "the bus was restarted" in hole.reason for hole in holes)
    assert sum(hole.lost or 0 for hole in holes) == lost(quality)
    assert len(holes) == len(load_manifest(folder).holes) == 2
    assert set(load_manifest(folder).servers) >= {"g1", "motion"}
    return quality


def says_bus_back(station: RobotStation) -> Counter[str]:
    """Return how often each server has said that the bus is back, on the bus or not."""
    return Counter({name: station.log(name).count(": bus-back") for name in SERVERS})


def cut_every_connection(address: BusAddress, place: Path) -> Quality:
    """Cut the connections of a station, one kind after the other; return what `check` finds."""
    with robot_station(address, place) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        for kind, event, told_by in (
            ("replica", "tap-resumed", ["recorder"]),
            ("pubsub", "watch-back", ["g1", "motion"]),
            ("normal", "bus-back", SERVERS),
        ):
            before = Counter(station.told(folder, event))
            assert _kill_clients(address, kind) >= 1
            wanted = before + Counter(told_by)
            wait_until(lambda event=event, wanted=wanted: Counter(station.told(folder, event)) >= wanted)  # type: ignore[misc]
        soon(lambda: station.gate() == "tracking")
        soon(lambda: station.bus.publish({"hello": b"1"}))
        station.ask("stop", success=True)
    quality = checked(folder)
    told = [found for found in quality.interruptions if found.kind not in ("bus-silent", "watch-cut")]
    assert (told[0].kind, told[0].told_by) == ("tap-cut", ["recorder"])
    # A busy machine may cut a watch a few times more.
    assert {name for found in of_kind(quality, "watch-cut") for name in found.told_by} == {"g1", "motion"}
    assert of_kind(quality, "watch-cut")[-1].at_s > told[0].at_s
    losses = of_kind(quality, "bus-lost")
    assert told[1:] == losses
    assert sorted(name for found in losses for name in found.told_by) == SERVERS
    assert of_kind(quality, "tap-cut")[0].lost == 0
    known = sum(found.lost or 0 for found in losses)
    assert 0 < lost(quality) <= known, "nothing is missing but what cut writers know to be lost"
    assert quality.holes == 0
    return quality


def _kill_clients(address: BusAddress, kind: str) -> int:
    admin = Connection(address, timeout_s=5.0)
    try:
        return int(admin.call("CLIENT", "KILL", "TYPE", kind, "SKIPME", "yes"))
    finally:
        admin.close()
