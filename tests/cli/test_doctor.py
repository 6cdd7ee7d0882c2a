"""``station doctor``: "it runs and the robot does nothing"; each broken state is found, and named with its remedy."""

from __future__ import annotations

import os
import re
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.server import read_health
from tests.cli.running import Home
from tests.servers.g1_station import LIGHT, G1Process
from tests.waiting import wait_until

KEY = twist_keys.action_body()
STANDING = codec.json_vector([0.0] * 35)


@pytest.fixture
def patient(bus_server: BusAddress, home: Home) -> tuple[Home, BusAddress]:
    """A home whose verbs go to a bus of its own."""
    home.environment["STATION_BUS"] = bus_server.url
    return home, bus_server


def findings(home: Home) -> dict[str, dict[str, Any]]:
    return {item["subject"]: item for item in home.json("doctor")}


@contextmanager
def writing(address: BusAddress, *names: str) -> Iterator[None]:
    """Write the body's command all the time: natively under a name, plainly for ``""``."""
    stop = threading.Event()

    def write(bus: Bus, name: str) -> None:
        while not stop.wait(0.02):
            if name:
                bus.publish({KEY: STANDING})
            else:
                bus.call("SET", KEY, STANDING)

    lines = [Bus(address, name=name or "stock", timeout_s=5.0) for name in names]
    threads = [threading.Thread(target=write, args=pair) for pair in zip(lines, names, strict=True)]
    for thread in threads:
        thread.start()
    try:
        if lines:
            wait_until(lambda: lines[0].get(KEY) is not None)  # a doctor that looks before it finds no writer at all
        yield
    finally:
        stop.set()
        for thread, line in zip(threads, lines, strict=True):
            thread.join()
            line.close()


def test_no_bus(home: Home) -> None:
    done = home.run("doctor")
    assert done.returncode == 1
    assert done.stdout.startswith(
        f"✗ bus: {home.bus}: No such file or directory\n    → does a station run there? `station up RUNBOOK` starts one"
    )
    assert "✓ versions: python " in done.stdout


def test_a_bus_without_servers(patient: tuple[Home, BusAddress]) -> None:
    found = findings(patient[0])
    assert found["bus"]["level"] == "ok"
    assert found["servers"]["level"] == "broken"
    assert found["servers"]["remedy"] == "start a station: station up g1-sim-motion"
    assert found["recorder"]["remedy"] == "station serve recorder"


def test_a_station_without_a_robot(live: Home) -> None:
    seen: list[Any] = [None]

    def is_written() -> bool:
        """Whether it sees the motion's writes and hears the recorder; on a busy machine none may come meanwhile."""
        done = seen[0] = live.run("doctor")
        written = f"✓ {KEY}: written by motion (pid {live.pids()['motion']}) at "
        return written in done.stdout and "✓ recorder: idle; `station record start` begins an episode" in done.stdout

    wait_until(is_written)
    (done,) = seen
    assert done.returncode == 1
    assert "✗ low-level server: none of ours runs: nothing turns commands into motion" in done.stdout


def test_a_stale_command(patient: tuple[Home, BusAddress]) -> None:
    home, address = patient
    with Bus(address, name="motion", timeout_s=5.0) as bus:
        bus.publish({KEY: STANDING})
    found = findings(home)[KEY]
    assert found["level"] == "broken"
    assert found["found"].startswith(f"stale: nobody writes it now (last: motion (pid {os.getpid()}), ")
    assert found["remedy"] == "start its command server again, or resume it"


def test_rival_writers(patient: tuple[Home, BusAddress]) -> None:
    home, address = patient
    found: dict[str, Any] = {}

    def are_seen() -> bool:
        """Whether both wrote while it looked, which a busy machine may keep one from."""
        found.update(findings(home)[KEY])
        return bool(found["found"].startswith("rival writers: "))

    with writing(address, "motion", ""):
        wait_until(are_seen)
    assert found["level"] == "broken"
    assert "a foreign writer" in found["found"]
    assert f"motion (pid {os.getpid()})" in found["found"]
    assert found["remedy"] == "stop all but one of them"


def test_a_latched_stop(patient: tuple[Home, BusAddress]) -> None:
    home, _ = patient
    assert findings(home)["e-stop"]["found"] == "released"
    home.run("estop", "--reason", "smoke")
    found = findings(home)["e-stop"]
    assert found["level"] == "broken"
    assert found["found"].startswith("the emergency stop is latched since ")
    assert found["found"].endswith(", smoke)")


def test_a_server_that_was_killed(home: Home) -> None:
    with home.running("up", "commands-only", "--set", "motion.loop=true") as station:
        station.wait_for("✓ start motion")
        with home.running("serve", "motion", "--name", "other", "--set", "motion=builtin:wave") as other:
            wait_until(lambda: "other" in home.pids())
            os.kill(other.process.pid, signal.SIGKILL)
            other.finish()
        found = findings(home)["server other"]
    assert found["level"] == "broken"
    assert found["found"] == f"fell silent without a farewell (pid {other.process.pid})"


def test_a_bus_that_is_open_to_the_network_or_forgetful(patient: tuple[Home, BusAddress]) -> None:
    home, address = patient
    with Bus(address, name="test", timeout_s=5.0) as bus:
        bus.call("CONFIG", "SET", "maxmemory-policy", "allkeys-lru")
        bus.call("CONFIG", "SET", "notify-keyspace-events", "")
    found = findings(home)
    assert found["bus memory"]["found"] == "policy allkeys-lru may drop a command key"
    assert found["bus notifications"]["level"] == "warning"


def test_junk_on_its_keys_does_not_stop_it(patient: tuple[Home, BusAddress]) -> None:
    home, address = patient
    with Bus(address, name="test", timeout_s=5.0) as bus:
        for key in (keys.server("g1"), keys.server_config("g1"), keys.ESTOP, keys.RECORDER, KEY):
            bus.call("SET", key, b"\xff\x00{")
    found = findings(home)
    assert found["e-stop"]["level"] == "broken", "in doubt it is a stop"
    assert found[KEY]["found"] == "stale: nobody writes it now (last: a foreign writer)"


def test_a_machine_without_upstream_data_lacks_nothing(patient: tuple[Home, BusAddress]) -> None:
    home, _ = patient
    found = findings(home.without("STATION_ASSETS"))["assets"]
    assert found["level"] == "ok"
    assert found["found"].startswith("built in; $STATION_ASSETS is not set, cache ")


def test_upstream_data_that_is_not_there(patient: tuple[Home, BusAddress]) -> None:
    home, _ = patient
    home.environment["STATION_ASSETS"] = "/nowhere"
    assert findings(home)["assets"] == {
        "level": "broken", "subject": "assets", "found": "/nowhere is not a folder", "remedy": "mend $STATION_ASSETS",
    }  # fmt: skip


def test_a_robot_that_gets_no_command_and_then_a_bad_one(patient: tuple[Home, BusAddress]) -> None:
    home, address = patient
    with G1Process(address, *LIGHT):
        with Bus(address, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: bus.get(keys.command_gate(twist_keys.TWIST2_ROBOT)) is not None)
        found = findings(home)
        assert found[KEY]["found"] == "nobody has ever written it"
        assert found["gate"]["found"].startswith("waiting")
        assert found["gate"]["level"] == "warning"
        with writing(address, "motion"), Bus(address, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: read_health(bus)[0].detail.get("refused"))
            found = findings(home)
        assert found[KEY]["level"] == "warning", "a height of zero is refused, and the doctor says so"
        assert found[KEY]["found"].startswith("commands refused since the start: ")


def test_a_robot_whose_loop_takes_longer_than_its_period(patient: tuple[Home, BusAddress]) -> None:
    home, address = patient
    with G1Process(address, "physics_dt_s=0.00002", "real_time_priority=0"), Bus(address, name="test") as bus:
        wait_until(lambda: any(health.why_late for health in read_health(bus)))
        found = findings(home)["loop of g1"]
        shown = home.run("status").stdout
    assert found["level"] == "warning"
    assert re.match(r"its loop does not keep its rate: .* \(\d+ of 50 Hz\)$", found["found"])
    assert re.search(r"g1 .* \d+\.\d of 50 Hz", shown)


def test_a_robot_that_is_disarmed(patient: tuple[Home, BusAddress]) -> None:
    home, address = patient
    with G1Process(address, *LIGHT, "start_armed=false"), Bus(address, name="test", timeout_s=5.0) as bus:
        gate = keys.command_gate(twist_keys.TWIST2_ROBOT)
        wait_until(lambda: bus.get(gate) is not None)
        found = findings(home)["arming"]
        assert found["level"] == "broken"
        assert found["remedy"] == "when everybody is clear: station arm"
        assert home.run("estop", "--reset", "--arm").returncode == 0
        wait_until(lambda: codec.parse_json(bus.get(gate) or b"{}")["arming"] != "disarmed")
