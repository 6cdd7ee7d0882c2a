"""A server of our own that is killed is there again, in the same place and for the same users."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.keeper import KeptServer
from station.bus.redis_server import RedisServer, ServerOptions
from station.errors import BusError
from tests.cli.running import are_gone, new_home
from tests.waiting import bus_answers, wait_until

pytestmark = pytest.mark.usefixtures("processes")

KEEP = """
import sys, threading
from pathlib import Path
from station.bus.keeper import KeptServer
from station.bus.server_options import ServerOptions

folder = Path(sys.argv[1])
with KeptServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock")) as server:
    print(server.pid, flush=True)
    threading.Event().wait()
"""


@pytest.fixture
def options(tmp_path: Path) -> ServerOptions:
    return ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock", password="secret")


def kill(kept: KeptServer) -> None:
    """Kill the server that is there, and wait for the next."""
    pid, restarts = kept.pid, kept.restarts
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: kept.restarts == restarts + 1)


def test_a_killed_server_is_back_in_its_place_and_asks_for_the_same_password(options: ServerOptions) -> None:
    told: list[str] = []
    with KeptServer.start(options, told.append) as kept, Bus(kept.address, name="g1", timeout_s=5.0) as bus:
        address, pid = kept.address, kept.pid
        bus.publish({"k": b"1"})
        kill(kept)
        wait_until(lambda: bus.publish({"k": b"2"}))
        assert (bus.get("k"), kept.address, bus.connections) == (b"2", address, 2)
        assert (options.folder / "bus.password").read_text().endswith("secret\n")
    assert kept.pid != pid
    assert told == [f"bus server was killed by signal 9; started again, pid {kept.pid}; what it held is gone"]
    assert sorted(file.name for file in options.folder.iterdir()) == ["bus.log"]


def test_one_that_is_told_to_shut_down_is_back_too(options: ServerOptions) -> None:
    with KeptServer.start(options) as kept, Bus(kept.address, name="admin", timeout_s=5.0) as bus:
        with pytest.raises(BusError):
            bus.call("SHUTDOWN", "NOSAVE")
        wait_until(lambda: kept.restarts == 1)
        wait_until(lambda: bus.publish({"k": b"1"}))


def test_one_that_cannot_be_started_says_so_at_once(options: ServerOptions) -> None:
    with RedisServer.start(options), pytest.raises(BusError, match="already running there"):
        KeptServer.start(options)


def test_one_that_cannot_come_back_is_given_up_and_says_why(
    options: ServerOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("station.bus.keeper._LONGEST_DELAY_S", 0.01)
    with KeptServer.start(options) as kept:
        shutil.rmtree(options.folder)
        os.kill(kept.pid, signal.SIGKILL)
        wait_until(lambda: kept.error is not None)
    assert "must exist" in str(kept.error)
    assert "given up" in str(kept.error)


def test_neither_the_first_nor_a_later_server_outlives_its_keeper(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", KEEP, str(tmp_path)], stdout=subprocess.PIPE, text=True) as keeper:
        assert keeper.stdout is not None
        first = int(keeper.stdout.readline())
        os.kill(first, signal.SIGKILL)
        address = BusAddress(socket=str(tmp_path / "bus.sock"))
        wait_until(lambda: bus_answers(address))
        with Bus(address, name="test", timeout_s=5.0) as bus:
            second = int(bus.call("INFO", "server").split(b"process_id:")[1].split()[0])
        assert second != first
        keeper.kill()
        wait_until(lambda: are_gone([second]))


def test_in_a_terminal_the_operator_is_told() -> None:
    with new_home() as home, home.running("bus", "start") as running:
        wait_until(home.bus_is_there)
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            wait_until(lambda: bus.call("CONFIG", "GET", "shutdown-timeout")[1] == b"0")  # its start is over
            pid = int(bus.call("INFO", "server").split(b"process_id:")[1].split()[0])
            os.kill(pid, signal.SIGKILL)
            running.wait_for("bus server was killed by signal 9; started again")
            wait_until(lambda: bus.publish({"k": b"1"}))
        running.interrupt()
        assert running.finish()[0] == 0
