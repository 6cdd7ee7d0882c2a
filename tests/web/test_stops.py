"""A stop that is pressed on a page while the bus accepts connections and answers nothing."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.life.stop_line import StopLine, StopReply
from station.web.stops import Stops
from tests.waiting import wait_until

_TRIES = 3  # a connection is given up after 1 s, for which a busy machine may hold this test up


def test_while_the_bus_hangs_presses_are_taken_on_and_robots_of_this_machine_are_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert any(_does_not_wait(tmp_path / f"{number}.sock") for number in range(_TRIES))


def _does_not_wait(path: Path) -> bool:
    """Press twice; return whether both were under way before the first one's connection was given up."""
    heard: list[str] = []

    def stop(reason: str) -> StopReply:
        heard.append(reason)
        return StopReply(told=("g1",))

    address = BusAddress(socket=str(path))
    with socket.socket(socket.AF_UNIX) as hangs, StopLine(address, stop) as line:
        assert line.failure == ""
        hangs.bind(str(path))
        hangs.listen()
        hangs.settimeout(10.0)
        with contextlib.closing(Stops(address, "test")) as stops:
            presses = [stops.press("1", "one")]
            connection, _ = hangs.accept()
            with connection:
                presses.append(stops.press("2", "two"))
                wait_until(lambda: len(heard) == 2)
                is_in_time = _is_open(connection)
                assert [press.result(10.0).outcome for press in presses] == ["past-bus", "past-bus"]
    assert sorted(reason.rpartition(", ")[2] for reason in heard) == ["one", "two"]
    return is_in_time


def _is_open(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        while connection.recv(4096):
            continue
    except BlockingIOError:
        return True
    return False
