"""What a server has to say while its bus is gone is said when it is back, and so is what it runs."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import msgspec
import pytest

from station.bus import codec, keys, outage
from station.bus.client import Bus
from station.bus.keeper import KeptServer
from station.bus.redis_server import RedisServer, ServerOptions
from station.life.server import Life, ServerKind
from tests.faults.bus_station import soon
from tests.servers.g1_station import Log, logged
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

KIND = ServerKind(name="arm", role="low-level", summary="", config=msgspec.Struct, main=lambda _config, _life: 0)


def names(log: Log) -> list[str]:
    return [codec.parse_json(value)["name"] for value in log.values(keys.EVENT)]


def test_events_that_the_bus_did_not_take_are_said_late_once_and_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outage, "_SETTLE_NS", 4_000_000_000)  # the log listens by then
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    with RedisServer.start(options) as first, Bus(first.address, name="arm") as bus:
        life = Life(KIND, "arm", bus, "")
        life.configured({"gains": 1})
        first.stop()
        wait_until(lambda: not bus.publish({"k": b"1"}))
        for name in ("command-lost", "fall"):
            life.event(name, tilt=1.0)
        with RedisServer.start(options) as second, logged(second.address) as log:
            wait_until(lambda: log.events("fall"))
            assert names(log) == ["bus-back", "command-lost", "fall"]
            (fall,) = log.events("fall")
            assert fall.detail["tilt"] == 1.0
            assert fall.detail["late_s"] > 0.5, "a recorder must have time to tap the bus again"
            (back,) = log.events("bus-back")
            assert back.detail["lost_writes"] >= 2
            life.end("over")
            assert names(log) == ["bus-back", "command-lost", "fall"]


def test_a_bus_that_is_back_before_anybody_looked_is_told_again_what_runs(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    with KeptServer.start(options) as kept, Bus(kept.address, name="arm") as bus:
        life = Life(KIND, "arm", bus, "")
        life.configured({"gains": 1})
        for restarts in (1, 2):
            os.kill(kept.pid, signal.SIGKILL)
            soon(lambda restarts=restarts: kept.restarts == restarts and bus.get(keys.server_config("arm")))  # type: ignore[misc]
        life.end("over")
