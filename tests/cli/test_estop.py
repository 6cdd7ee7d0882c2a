"""``station estop``: acts on the next step, stays latched, and lets go only when an operator says so."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.joints import G1_29
from station.bus.tap import Write
from tests.cli.running import Home, Running, new_home, one_line
from tests.lateness import TooLate, Waits, in_time
from tests.servers.g1_station import LIGHT, Log, logged
from tests.waiting import wait_until

PERIOD_S = 0.02
ROBOT = keys.TWIST2_ROBOT
GATE = keys.command_gate(ROBOT)
SETTINGS = (*(f"g1.{setting}" for setting in LIGHT), "motion.motion=builtin:wave", "motion.loop=true",
            "motion.enter_s=0.1", "motion.leave_s=0.1")  # fmt: skip


@pytest.fixture(scope="module")
def driven() -> Iterator[tuple[Home, Running]]:
    """A simulated robot that follows a motion."""
    sets = [word for setting in SETTINGS for word in ("--set", setting)]
    with new_home() as home, home.running("up", "g1-sim-motion", "--yes", *sets) as station:
        station.wait_for("to=tracking")
        yield home, station


def states(writes: list[Write]) -> list[str]:
    return [codec.parse_json(write.value)["state"] for write in writes if write.key == GATE and write.value]


def test_the_robot_is_damped_within_a_step_and_follows_again_after_a_reset(driven: tuple[Home, Running]) -> None:
    in_time(lambda: stop_and_reset(driven[0]))


def stop_and_reset(home: Home) -> None:
    waits = Waits()
    with logged(home.bus) as log:
        done = home.run("estop", "--reason", "a test")
        assert done.returncode == 0
        assert "every robot on this bus is damped; `station estop --reset` releases" in done.stdout
        wait_until(lambda: "stopped" in states(log.writes))
        waited_s = waits.seconds()
        assert home.run("estop", "--reset").stdout == "e-stop released\n"
        wait_until(lambda: "tracking" in states(after_the_stop(log)))
    targets = [write for write in log.writes if write.key == keys.target(ROBOT)]
    first = next(
        n for n, write in enumerate(log.of(GATE)) if codec.parse_json(write.value or b"")["state"] == "stopped"
    )
    stiffness = codec.parse_f64(targets[first].value or b"")[len(G1_29) : 2 * len(G1_29)]
    assert not stiffness.any(), "damped: no stiffness"
    names = [event["name"] for event in events(log)]
    assert names.index("estop") < names.index("operator-reset")
    stopped_at = next(n for n, write in enumerate(log.writes) if write.key == keys.ESTOP)
    before = states(log.writes[stopped_at:]).index("stopped")
    if before > 1:  # at most the step that was under way when the stop was written
        raise TooLate("the stop", (before - 1) * PERIOD_S, waited_s)


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
        wait_until(lambda: codec.parse_json(bus.get(GATE) or b"{}").get("state") == "tracking")


def test_a_stop_that_no_bus_takes_is_no_success(home: Home) -> None:
    assert "start one with `station bus start`" in one_line(home.run("estop"))


def test_any_other_value_of_the_key_stops_too(driven: tuple[Home, Running]) -> None:
    home, _ = driven
    with Bus(home.bus, name="test", timeout_s=5.0) as bus, logged(BusAddress(socket=home.bus.socket)) as log:
        bus.call("SET", keys.ESTOP, b"\xff")
        wait_until(lambda: "stopped" in states(log.writes))
        home.run("estop", "--reset")
        wait_until(lambda: states(log.writes)[-1] != "stopped")


def after_the_stop(log: Log) -> list[Write]:
    writes = list(log.writes)
    stops = [n for n, write in enumerate(writes) if write.key == GATE and b'"stopped"' in (write.value or b"")]
    return writes[stops[-1] :] if stops else []


def events(log: Log) -> list[dict[str, Any]]:
    return [codec.parse_json(value) for value in log.values(keys.EVENT)]
