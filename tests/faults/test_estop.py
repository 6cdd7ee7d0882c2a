"""The emergency stop, written by anybody, while those who are not needed for it are dead."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from servers.g1 import G1Config
from station.bus import codec, keys
from station.bus.connection import Connection
from station.episode.reading.reader import open_episode
from station.life.server import HEARTBEAT_S, Health, read_health
from tests.faults.moving_station import MovingStation
from tests.faults.onlooker import ROBOT
from tests.faults.stops import Stop, stop_without_supervisor
from tests.servers.g1_station import StockCommander
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


def test_it_damps_the_robot_while_recorder_and_command_server_are_dead_and_is_recorded(tmp_path: Path) -> None:
    with (
        MovingStation(tmp_path, physics_dt_s=0.002) as station,
        closing(Connection(station.address, timeout_s=5.0)) as line,
    ):
        station.ask("start", task="stop")
        station.play("builtin:walk-forward", enter_s=0.1)
        station.kill("recorder")
        station.kill("motion")
        Stop(station.onlooker, line).wait_until_damped()
        assert stays_stopped(station, lambda: line.call("DEL", keys.ESTOP)), "no value is no reset"
        with StockCommander(station.address):
            assert stays_stopped(station, lambda: None), "neither is a command that comes anew"
        line.call("SET", keys.ESTOP, b"1")
        station.kill("g1")
        assert stays_stopped(station, lambda: station.start_again("g1")), "it survives the server that obeys it"
        since_ns = time.monotonic_ns()
        line.call("SET", keys.ESTOP, b"0")
        station.wait_for_gate("waiting", since_ns)
        station.start_again("motion")
        station.wait_for_gate("tracking", since_ns)
        station.supervisor.wait_for("recorder", "active", 60)
        folder = Path(station.ask("stop").path or "")
    assert_recorded(folder, [b"1", b"1", b"0"])


def stays_stopped(station: MovingStation, act: Callable[[], object]) -> bool:
    """Whether all steps for half a second are damped, whatever is done."""
    since_ns = time.monotonic_ns()
    act()
    station.wait_s(0.5)
    return all(step.damped and step.gate == "stopped" for step in station.onlooker.since(since_ns))


def test_a_restarted_bus_is_told_again_so_a_robot_that_starts_only_then_is_stopped_too(tmp_path: Path) -> None:
    with MovingStation(tmp_path, record=False, physics_dt_s=0.002) as station:
        station.play("builtin:wave", enter_s=0.1)
        since_ns = time.monotonic_ns()
        station.bus.publish({keys.ESTOP: b'{"stop": true, "reason": "somebody came near"}'})
        station.wait_for_gate("stopped", since_ns)
        station.kill_bus()
        station.start_bus()
        wait_until(lambda: (station.bus.get(keys.ESTOP) or b"").count(b"somebody came near"))
        station.supervisor.spawn("g1-later", G1Config(physics_dt_s=0.002), server="g1")
        station.supervisor.activate("g1-later")
        wait_until(lambda: gate_of(station, "g1-later") == "stopped", 60)
        station.bus.publish({keys.ESTOP: b'{"stop": false}'})
        wait_until(lambda: "stopped" not in (gate_of(station, "g1"), gate_of(station, "g1-later")))
        station.kill_bus()
        station.start_bus()
        wait_until(lambda: all(health_of(station, name) for name in ("g1", "g1-later")))
        station.wait_s(2 * HEARTBEAT_S)
        assert station.bus.get(keys.ESTOP) is None, "what was released is not said again"


def health_of(station: MovingStation, name: str) -> Health | None:
    return next((health for health in read_health(station.bus) if health.name == name and health.is_alive), None)


def gate_of(station: MovingStation, name: str) -> str:
    health = health_of(station, name)
    return str(health.detail.get("gate", "")) if health is not None else ""


def assert_recorded(folder: Path, written: list[bytes]) -> None:
    """The key as it was written, the event, and every state of the gate stand in the episode."""
    told: dict[str, list[bytes]] = {keys.ESTOP: [], keys.EVENT: [], keys.command_gate(ROBOT): []}
    for message in open_episode(folder).messages():
        if message.topic in told:
            told[message.topic].append(message.data)
    assert [data for data in told[keys.ESTOP] if data] == written
    names = [codec.parse_json(data)["name"] for data in told[keys.EVENT]]
    assert names.index("estop") < names.index("operator-reset")
    assert any(codec.parse_json(data)["state"] == "stopped" for data in told[keys.command_gate(ROBOT)])


def test_without_its_supervisor_the_robot_is_damped_or_released() -> None:
    stop_without_supervisor()
