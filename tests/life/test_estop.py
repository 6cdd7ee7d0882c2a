"""What the emergency stop's key asks for."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import msgspec
import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.keeper import KeptServer
from station.bus.server_options import ServerOptions
from station.life.estop import read, restate
from station.supervision.stop_memory import StopMemory
from tests.faults.bus_station import soon
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.mark.parametrize("data", [b"", b"0", b" 0\n", b'{"stop": false}', b'{"stop": false, "who": "anna"}'])
def test_these_values_reset(data: bytes) -> None:
    assert not read(data).stop


@pytest.mark.parametrize(
    "data",
    [b"1", b"stop", b"{}", b"[]", b'{"stop": true}', b'{"stop": 0}', b'{"stop": null}', b'{"stop": "false"}', b"\xff",
     b"null", b"false", b"00", b'{"stop": fal', b"[" * 9999],
)  # fmt: skip
def test_everything_else_stops(data: bytes) -> None:
    assert read(data).stop


def test_who_asked_and_why_are_kept() -> None:
    assert read(b'{"stop": true, "who": "anna", "reason": "smoke"}').reason == "anna, smoke"


def test_arming_is_asked_for_only_with_a_reset() -> None:
    assert read(b'{"stop": false, "arm": true}').arm
    assert not read(b'{"stop": true, "arm": true}').arm
    assert not read(b'{"stop": false, "arm": "yes"}').arm
    assert not read(b"0").arm


@pytest.mark.parametrize("value", [b'{"stop": false}', b"0", b"", b"1"])
def test_what_anybody_has_written_since_is_never_overwritten_by_a_stop_that_is_said_again(
    bus_server: BusAddress, value: bytes
) -> None:
    with Bus(bus_server, name="g1", timeout_s=5.0) as bus:
        bus.call("SET", keys.ESTOP, value)
        assert not restate(bus, "somebody came near", "g1")
        assert bus.get(keys.ESTOP) == value
        bus.call("DEL", keys.ESTOP)
        assert restate(bus, "somebody came near", "g1")
        request = read(bus.get(keys.ESTOP) or b"")
        assert (request.stop, request.reason) == (True, "somebody came near")


def test_a_station_says_a_stop_again_that_its_bus_has_forgotten_and_a_released_one_never(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    with (
        KeptServer.start(options) as kept,
        Bus(kept.address, name="supervisor", timeout_s=1.0) as bus,
        StopMemory(bus, "supervisor") as memory,
    ):
        bus.publish({keys.ESTOP: b'{"stop": true, "reason": "smoke"}'})
        soon(lambda: memory.is_stopped)
        os.kill(kept.pid, signal.SIGKILL)
        soon(lambda: memory.poll() == "smoke")
        assert read(bus.get(keys.ESTOP) or b"").reason == "smoke"
        bus.publish({keys.ESTOP: b'{"stop": false}'})
        soon(lambda: not memory.is_stopped)
        wait_until(lambda: kept.restarts == 1)
        os.kill(kept.pid, signal.SIGKILL)
        soon(lambda: memory.has_forgetful_bus)
        assert memory.poll() == ""
        soon(lambda: bus.call("EXISTS", keys.ESTOP) == 0)


def test_a_stop_and_a_release_of_which_no_word_has_come_yet_count_where_they_are_asked_for(
    bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as bus, StopMemory(bus, "supervisor") as memory:
        monkeypatch.setattr(memory._watch, "latest", lambda key: None)
        assert memory.latched() is None
        bus.publish({keys.ESTOP: b'{"stop": true, "reason": "smoke"}'})
        latched = memory.latched()
        assert latched is not None
        assert latched.reason == "smoke"
        heard = msgspec.structs.replace(bus.read([keys.ESTOP])[keys.ESTOP], arrived_ns=time.monotonic_ns())
        monkeypatch.setattr(memory._watch, "latest", {keys.ESTOP: heard}.get)
        bus.publish({keys.ESTOP: b'{"stop": false}'})
        memory._keeper.file.release("anna")
        assert memory.latched() is None, "of the release no word has come yet"
        bus.call("DEL", keys.ESTOP)
        assert memory.latched() is not None, "a bus that has forgotten it releases nothing"
