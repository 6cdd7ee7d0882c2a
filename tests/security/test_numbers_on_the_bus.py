"""Numbers that no float holds, nests and names without end, on the bus of real processes: none of them ends by it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote
from station.life.server import read_health
from tests.servers.g1_station import FORMAT, PATIENT, G1Process, logged, publish, ticks
from tests.waiting import wait_until

HUGE = b"1" + b"0" * 400
HEARTBEAT = (
    b'{"name": "ghost", "role": "low-level", "state": "active", "pid": %(number)b, "host": "h", "boot": "b", '
    b'"source": "ghost.1.ab.cd", "started_wall_ns": 1, "wall_ns": %(number)b, "rate_hz": 1.5, '
    b'"detail": {"falls": %(number)b}}'
)
CONFIG = (
    b'{"kind": "g1", "role": "low-level", "robot": "r", "policy": {"command": "twist2", "rate_hz": %(number)b}, '
    b'"robot_facts": {"mass_kg": %(number)b}}'
)
NUMBERS = (HUGE, b"-" + HUGE, b"9" * 4000, b"9223372036854775808", b"1e308", b"[" * 900 + b"]" * 900)
LONG_NAME = HEARTBEAT.replace(b'"ghost"', b'"' + b"x" * 5000 + b'"') % {b"number": b"1"}


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="test", timeout_s=5.0) as line:
        yield line


def haunt(bus: Bus, number: bytes) -> None:
    """Write a number wherever a process looks for one: in what servers say, in requests, events and stamps."""
    values = {keys.server("ghost"): HEARTBEAT, keys.server_config("ghost"): CONFIG}
    for key, value in values.items():
        bus.call("SET", key, value % {b"number": number})
    for key in (keys.RECORDER, keys.command_gate("r"), keys.command_source("r"), keys.MOTION_CONTROL, keys.ARM):
        bus.call("SET", key, b'{"state": "recording", "dropped": %(n)b, "time_s": %(n)b, "id": %(n)b}' % {b"n": number})
    bus.call("SET", keys.EVENT, b'{"name": "fall", "severity": "info", "source": "g", "wall_ns": %b}' % number)
    bus.call("MSET", "haunted", b"1", keys.stamp("haunted"), b"%(n)b %(n)b %(n)b x" % {b"n": number})


def station(address: BusAddress, *arguments: str) -> tuple[int, str]:
    """Run a command; return its exit code and what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "station", *arguments], capture_output=True, check=False, timeout=60, text=True,
        env={**os.environ, "STATION_BUS": address.url, "COLUMNS": "100"},
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr[-2000:]
    return done.returncode, done.stdout


def test_a_g1_refuses_a_command_of_huge_integers_and_follows_the_next_good_one(
    bus_server: BusAddress, bus: Bus
) -> None:
    with G1Process(bus_server, *PATIENT) as g1, logged(bus_server) as log:
        wait_until(lambda: ticks(log) > 10)

        def follows() -> bool:
            publish(bus, FORMAT.default)
            return log.states()[-1] == "tracking"

        wait_until(follows)
        bus.publish({twist_keys.action_body(): b"[" + b", ".join([HUGE] * len(FORMAT.default)) + b"]"})
        refused = log.wait_for("refused-command")
        assert "an integer of 401 digits" in str(refused.detail)
        for number in NUMBERS:
            haunt(bus, number)
        before = ticks(log)
        wait_until(lambda: follows() and ticks(log) > before + 20)
        assert g1.process.poll() is None
        code, _, words = g1.finish()
        assert (code, "Traceback" in words) == (0, False), words[-2000:]


def test_a_recorder_survives_a_huge_rate_before_and_within_an_episode_that_stays_good(
    bus_server: BusAddress, bus: Bus, tmp_path: Path
) -> None:
    words = tmp_path / "recorder.log"
    environment = {**os.environ, "STATION_BUS": bus_server.url, "STATION_DATA": str(tmp_path / "data")}
    arguments = [sys.executable, "-m", "station", "serve", "recorder", "--set", "min_free_mb=1"]
    with words.open("wb") as log, subprocess.Popen(arguments, stdout=log, stderr=log, env=environment) as recorder:
        try:
            wait_until(lambda: any(health.state == "active" for health in read_health(bus)))
            haunt(bus, HUGE)
            assert remote.ask(bus, "start", timeout_s=30.0, task="huge").ok
            for number in NUMBERS:
                haunt(bus, number)
                bus.publish({"native": number})
            stopped = remote.ask(bus, "stop", timeout_s=30.0)
            assert recorder.poll() is None, words.read_text()[-2000:]
            recorder.terminate()
            assert recorder.wait(60) == 0
        finally:
            recorder.kill()
    reader = open_episode(Path(str(stopped.path)))
    assert reader.manifest.state == "finished"
    assert [message.data for message in reader.messages(["native"])] == list(NUMBERS)
    assert len(list(reader.messages([keys.server_config("ghost")]))) >= len(NUMBERS)
    check(reader)
    assert (stopped.summary["lost"], stopped.summary["dropped"]) == (0, 0)
    assert "Traceback" not in words.read_text()


@pytest.mark.parametrize("number", [HUGE, b"9223372036854775808"], ids=["400-digits", "64-bits"])
def test_status_and_doctor_print_what_they_can(bus_server: BusAddress, bus: Bus, number: bytes) -> None:
    haunt(bus, number)
    bus.call("SET", keys.server("long"), LONG_NAME)
    deep = HEARTBEAT.replace(b'"falls": %(number)b', b'"falls": ' + b"[" * 900 + b"]" * 900)
    bus.call("SET", keys.server("deep"), deep % {b"number": b"%d" % time.time_ns()})
    code, shown = station(bus_server, "status")
    assert (code, "haunted" in shown) == (0, True)
    code, shown = station(bus_server, "status", "--json")
    assert code == 0
    assert "haunted" in [item["key"] for item in json.loads(shown)["keys"]]
    code, shown = station(bus_server, "doctor", "--json")
    assert code == 1  # no server runs
    assert "server " + "x" * 5000 in [item["subject"] for item in json.loads(shown)]
    assert station(bus_server, "doctor")[0] == 1
