"""The emergency stop, written by anybody, while those who are not needed for it are dead."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from servers.g1 import G1Config
from station.bus import codec, keys
from station.bus.connection import Connection
from station.episode.reading.reader import open_episode
from station.life.server import HEARTBEAT_S, Health, read_health
from tests.cli.running import Home, are_gone, new_home
from tests.faults.moving_station import MovingStation
from tests.faults.onlooker import ROBOT, Onlooker, Step
from tests.lateness import TooLate, Waits, in_time
from tests.servers.g1_station import LIGHT
from tests.waiting import wait_until

PERIOD_S = 0.02
LIGHT_G1 = [word for setting in LIGHT for word in ("--set", f"g1.{setting}")]


class Stop:
    """The stop as a stranger writes it."""

    def __init__(self, onlooker: Onlooker, line: Connection, waits: Waits) -> None:
        self._onlooker, self._waits = onlooker, waits
        self._since_ns = time.monotonic_ns()
        line.call("SET", keys.ESTOP, b"1")

    @property
    def steps(self) -> list[Step]:
        """Those that were published since."""
        return self._onlooker.since(self._since_ns)

    def wait_until_damped(self, otherwise: Callable[[], bool] = lambda: False) -> None:
        """Wait until a step is; no other than the one that was under way may still have had stiffness."""
        wait_until(lambda: any(step.damped for step in self.steps) or otherwise())
        waited_s = self._waits.seconds()
        if late := [step for step in self.steps[1:] if not (step.damped and step.gate == "stopped")]:
            raise TooLate("the stop", (late[-1].mono_ns - self._since_ns) * 1e-9 - PERIOD_S, waited_s)


def test_it_damps_the_robot_while_recorder_and_command_server_are_dead_and_is_recorded(tmp_path: Path) -> None:
    with (
        MovingStation(tmp_path, physics_dt_s=0.002) as station,
        closing(Connection(station.address, timeout_s=5.0)) as line,
    ):
        station.ask("start", task="stop")
        station.play("builtin:walk-forward")
        station.kill("recorder")
        station.kill("motion")
        written = damp_in_time(station, line)
        assert stays_stopped(station, lambda: line.call("DEL", keys.ESTOP)), "no value is no reset"
        assert stays_stopped(station, lambda: station.start_again("motion")), "neither is a command that comes anew"
        line.call("SET", keys.ESTOP, b"1")
        station.kill("g1")
        assert stays_stopped(station, lambda: station.start_again("g1")), "it survives the server that obeys it"
        since_ns = time.monotonic_ns()
        line.call("SET", keys.ESTOP, b"0")
        station.wait_for_gate("tracking", since_ns)
        station.supervisor.wait_for("recorder", "active", 60)
        folder = Path(station.ask("stop").path or "")
    assert_recorded(folder, [*written, b"1", b"0"])


def damp_in_time(station: MovingStation, line: Connection) -> list[bytes]:
    """Stop the robot, which damps it at once; return what was written for that."""
    written: list[bytes] = []

    def stop() -> None:
        if written:
            line.call("SET", keys.ESTOP, b"0")
            written.append(b"0")
            wait_until(lambda: station.onlooker.steps[-1].gate != "stopped")
        written.append(b"1")
        Stop(station.onlooker, line, Waits()).wait_until_damped()

    in_time(stop)
    return written


def stays_stopped(station: MovingStation, act: Callable[[], object]) -> bool:
    """Whether all steps for half a second are damped, whatever is done."""
    since_ns = time.monotonic_ns()
    act()
    station.wait_s(0.5)
    return all(step.damped and step.gate == "stopped" for step in station.onlooker.since(since_ns))


def test_a_restarted_bus_is_told_again_so_a_robot_that_starts_only_then_is_stopped_too(tmp_path: Path) -> None:
    with MovingStation(tmp_path, record=False, physics_dt_s=0.002) as station:
        station.play("builtin:wave")
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


def test_without_its_supervisor_the_robot_is_damped_or_released_at_once() -> None:
    in_time(lose_the_supervisor)


def lose_the_supervisor() -> None:
    with new_home() as home, home.running("bus", "start") as bus:
        assert bus.process.stdout is not None
        bus.process.stdout.readline()
        with home.running("up", "g1-sim-motion", "--yes", "--set", "motion.loop=true", *LIGHT_G1) as station:
            station.wait_for("to=tracking")
            pids = list(home.pids().values())
            with Onlooker(home.bus) as onlooker, closing(Connection(home.bus, timeout_s=5.0)) as line:
                wait_until(lambda: onlooker.steps)
                waits = Waits()
                station.process.kill()
                stop = Stop(onlooker, line, waits)  # as one would write it who sees the robot go on
                stop.wait_until_damped(otherwise=lambda: are_gone(pids))
                wait_until(lambda: are_gone(pids))
                assert all(step.damped for step in stop.steps[1:]), "until it ends, it obeys"
            assert finalized(home, "g1"), "it ended by itself, in the robot's safe state"


def finalized(home: Home, name: str) -> bool:
    return home.health()[name].state == "finalized"
