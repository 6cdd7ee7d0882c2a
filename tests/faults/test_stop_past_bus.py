"""The emergency stop where the bus was killed or is frozen: robots of this machine are damped all the same."""

from __future__ import annotations

import getpass
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from station import Station
from station.bus.redis_server import RedisServer, ServerOptions
from station.errors import BusError, StoppedPastBus
from station.life.stop_button import StopButton
from station.life.stop_file import StopFile
from tests.cli.running import Home, Running, new_home, one_line
from tests.faults.onlooker import Onlooker
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

BOOK = """
runbook: t
robot: unitree_g1_with_hands
steps:
  - start: g1
    with: {physics_dt_s: 0.002, real_time_priority: 0}
    ready_within: 60s
  - start: motion
    with: {motion: "builtin:walk-forward", loop: true, enter_s: 0.1, leave_s: 0.1}
"""


class Lab:
    """A station of one robot that walks, on a bus that is there to be broken."""

    def __init__(self, home: Home, station: Running, options: ServerOptions, server: RedisServer) -> None:
        self.home, self.station, self._options, self.server = home, station, options, server

    @property
    def log(self) -> str:
        (path,) = Path(self.home.environment["XDG_RUNTIME_DIR"]).rglob("g1.log")
        return path.read_text(errors="replace")

    def break_bus(self, how: signal.Signals) -> None:
        os.kill(self.server.pid, how)

    def mend_bus(self, how: signal.Signals) -> None:
        if how == signal.SIGSTOP:
            os.kill(self.server.pid, signal.SIGCONT)
            return
        self.server.stop()  # clears away what the dead one left
        self.server = RedisServer.start(self._options)

    def expect_damped(self, how: signal.Signals, reason: str) -> None:
        """Wait until the robot says that it is stopped; once the bus is back, that all its steps are damped."""
        wait_until(lambda: f"to=stopped reason={reason}" in self.log)
        self.mend_bus(how)
        with Onlooker(self.home.bus) as onlooker:
            wait_until(lambda: len(onlooker.steps) > 5)
            assert all(step.damped and step.gate == "stopped" for step in onlooker.steps)


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    with new_home() as home:
        for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
            monkeypatch.setenv(name, home.environment[name])
        with running_lab(home) as made:
            yield made


@contextmanager
def running_lab(home: Home) -> Iterator[Lab]:
    path = Path(home.bus.socket or "")
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    options = ServerOptions(folder=path.parent, socket=path)
    book = path.parent / "book.yaml"
    book.write_text(BOOK)
    server = RedisServer.start(options)
    made = None
    try:
        # Somebody attends it: it stays up when the motion ends with the stop.
        with home.running("up", str(book), "--ask", "console") as station:
            station.wait_for("to=tracking")
            made = Lab(home, station, options, server)
            yield made
    finally:
        (made.server if made is not None else server).stop()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_station_estop_damps_a_walking_robot_and_says_how(lab: Lab, how: signal.Signals) -> None:
    lab.break_bus(how)
    said = one_line(lab.home.run("estop", "--reason", "it smokes"))
    assert said.startswith("stopped past the bus: g1; the bus did not take the stop (")
    assert said.endswith("so see that every robot is damped; it is latched for the next start")
    assert "it smokes" in str(StopFile(lab.home.bus).read())
    lab.expect_damped(how, f"{getpass.getuser()}, it smokes")
    lab.station.interrupt()
    lab.station.finish()
    assert "the emergency stop is latched since " in one_line(lab.home.run("up", "g1-sim-motion", "--yes"))


def test_a_button_and_a_script_that_were_there_before_stop_it_past_a_frozen_bus(lab: Lab) -> None:
    with StopButton(lab.home.bus, name="pedal", who="ada") as button, Station(lab.home.bus.url) as script:
        lab.break_bus(signal.SIGSTOP)
        with pytest.raises(StoppedPastBus, match=r"^stopped past the bus: g1; the bus did not take") as stopped:
            button.press("pedal")
        assert stopped.value.told == ("g1",)
        with pytest.raises(StoppedPastBus, match=r"^stopped past the bus: g1; the bus did not take"):
            script.estop("again")
        lab.expect_damped(signal.SIGSTOP, "ada, pedal")


def test_where_the_station_was_killed_too_it_says_that_nothing_was_stopped(lab: Lab) -> None:
    with StopButton(lab.home.bus, who="ada") as button:
        lab.station.process.kill()
        lab.station.process.wait()
        lab.break_bus(signal.SIGKILL)
        assert list(Path(lab.home.bus.socket or "").parent.glob("stop-*.sock")), "what it left is passed over"
        with pytest.raises(BusError, match=r"the stop was NOT taken .*; use the robot's own stop") as error:
            button.press("a test")
        assert not isinstance(error.value, StoppedPastBus)
        said = one_line(lab.home.run("estop"))
        assert said.startswith("NO robot was stopped (")
        assert said.endswith("the stop is latched for the next start")
