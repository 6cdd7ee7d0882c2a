"""``station estop``: acts on the next step, stays latched, and lets go only when an operator says so."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from tests.cli.running import Home, Running, one_line
from tests.cli.stopped import GATE, driven_robot, states, stop_and_reset
from tests.servers.g1_station import logged
from tests.waiting import wait_until


@pytest.fixture(scope="module")
def driven(processes: None) -> Iterator[tuple[Home, Running]]:
    """A simulated robot; what commands it comes and goes."""
    with driven_robot() as made:
        yield made


def test_the_robot_is_damped_and_stands_after_a_reset(driven: tuple[Home, Running]) -> None:
    stop_and_reset(driven[0])


def test_a_stop_is_latched_and_told_by_the_doctor(driven: tuple[Home, Running]) -> None:
    home, station = driven
    home.run("estop", "--reason", "a test")
    station.wait_for("to=stopped")
    found = {item["subject"]: item for item in home.json("doctor")}
    assert found["e-stop"]["level"] == "broken"
    assert "a test" in found["e-stop"]["found"]
    assert found["e-stop"]["remedy"] == "station estop --reset"
    assert found["gate"]["found"].startswith("stopped")
    home.run("estop", "--reset")
    with Bus(home.bus, name="test", timeout_s=5.0) as bus:
        wait_until(lambda: codec.parse_json(bus.get(GATE) or b"{}").get("state") == "waiting")


def test_a_stop_that_no_bus_takes_is_no_success(home: Home) -> None:
    assert "does a station run there? `station up RUNBOOK` starts one" in one_line(home.run("estop"))


def test_a_file_of_defaults_that_cannot_be_read_is_in_the_way_only_of_a_bus_that_is_not_named(home: Home) -> None:
    file = Path(home.environment["XDG_CONFIG_HOME"]) / "station" / "config.yaml"
    file.parent.mkdir(parents=True)
    file.write_text("data: [")
    refused = one_line(home.run("estop"))
    assert refused.startswith(f"NO robot was stopped ({file}: not YAML at line ")
    assert refused.endswith("; --bus URL names the bus")
    assert "the stop is latched for the next start" in one_line(home.run("estop", "--bus", home.bus.url))


def test_a_bulk_bus_that_is_no_address_is_in_no_way_of_a_stop(driven: tuple[Home, Running]) -> None:
    home, _ = driven
    home.environment |= {"STATION_BULK": "nonsense"}
    done = home.run("estop")
    assert done.returncode == 0, done.stderr
    assert home.run("estop", "--reset").returncode == 0


def test_any_other_value_of_the_key_stops_too(driven: tuple[Home, Running]) -> None:
    home, _ = driven
    with Bus(home.bus, name="test", timeout_s=5.0) as bus, logged(BusAddress(socket=home.bus.socket)) as log:
        bus.call("SET", keys.ESTOP, b"\xff")
        wait_until(lambda: "stopped" in states(log.writes))
        home.run("estop", "--reset")
        wait_until(lambda: states(log.writes)[-1] != "stopped")
