"""The emergency stop's button: what it says is what happened."""

from __future__ import annotations

import getpass
import os
import signal
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.errors import BusError
from station.life import server
from station.life.stop_button import StopButton
from tests.faults.bus_station import soon
from tests.servers.g1_station import LIGHT, G1Process, logged
from tests.waiting import DEADLINE_S, wait_until

pytestmark = pytest.mark.usefixtures("processes")


def test_what_is_pressed_stands_on_the_bus_with_who_and_why(bus_server: BusAddress) -> None:
    with StopButton(bus_server) as button, Bus(bus_server, name="t", timeout_s=5.0) as bus:
        button.press("a test")
        button.press("a test")
        wanted = {"stop": True, "who": getpass.getuser(), "reason": "a test"}
        assert codec.parse_json(bus.get(keys.ESTOP) or b"") == wanted
        button.release("enough", arm=True)
        assert codec.parse_json(bus.get(keys.ESTOP) or b"") == wanted | {"stop": False, "reason": "enough", "arm": True}
        assert button.robots() == []


def test_it_tells_when_the_robots_have_obeyed_and_which_have_not(
    bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "DEAD_AFTER_S", DEADLINE_S)  # a robot that is stopped where it stands says no more
    with StopButton(bus_server) as button, logged(bus_server) as log, G1Process(bus_server, *LIGHT) as robot:
        soon(lambda: button.robots() == ["g1"])
        wait_until(log.states)
        button.press("a test")
        soon(lambda: button.unstopped(DEADLINE_S) == {})
        button.release("a test")
        wait_until(lambda: log.events("operator-reset") and log.states()[-1] == "waiting")
        os.kill(robot.process.pid, signal.SIGSTOP)
        button.press("a test")
        soon(lambda: button.unstopped(0.1) == {"g1": "waiting"})


def test_a_bus_that_is_frozen_has_taken_nothing(tmp_path: Path) -> None:
    with (
        RedisServer.start(ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")) as server,
        StopButton(server.address) as button,
    ):
        os.kill(server.pid, signal.SIGSTOP)
        try:
            with pytest.raises(BusError, match=r"the stop was NOT taken \(bus .*\); use the robot's own stop"):
                button.press("a test")
        finally:
            os.kill(server.pid, signal.SIGCONT)


def test_a_bus_that_was_away_takes_it_as_soon_as_it_is_back(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    server = RedisServer.start(options)
    with StopButton(server.address) as button:
        server.stop()
        with pytest.raises(BusError, match=r"NOT taken"):
            button.press("a test")
        with RedisServer.start(options) as again, Bus(again.address, name="t", timeout_s=5.0) as bus:

            def is_taken() -> bool:
                with suppress(BusError):
                    button.press("a test")
                return bus.get(keys.ESTOP) is not None

            wait_until(is_taken)  # it comes back by itself


def test_a_user_whose_list_knows_no_key_for_a_press_alone_still_stops(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="t", timeout_s=5.0) as bus:
        patterns = (f"%W~{keys.ESTOP}", f"%W~{keys.stamp(keys.ESTOP)}", "%R~*")
        bus.call("ACL", "SETUSER", "command", "reset", "on", ">secret", "allchannels", *patterns, "+@all")
        address = msgspec.structs.replace(bus_server, username="command", password="secret")
        with StopButton(address) as button:
            button.press("a test")
        assert codec.parse_json(bus.get(keys.ESTOP) or b"")["stop"] is True
        bus.call("ACL", "DELUSER", "command")


def test_a_stop_that_may_not_be_written_is_told(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="t", timeout_s=5.0) as bus, StopButton(bus_server) as button:
        bus.call("ACL", "SETUSER", "default", "-mset")
        with pytest.raises(BusError, match=r"NOT taken .*permission"):
            button.press("a test")
        bus.call("ACL", "SETUSER", "default", "+mset")
