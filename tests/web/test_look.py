"""What a console is told of a bus with a great many keys, and of a server whose loop does not keep its rate."""

from __future__ import annotations

import contextlib
import time

import msgspec
import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.server import Health
from station.web.look import Look
from tests.waiting import wait_until


def test_a_loop_that_does_not_keep_its_rate_is_an_alarm_until_it_does(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="g1") as bus, contextlib.closing(Look(bus_server, "console")) as look:
        health = Health(
            name="g1", role="low-level", state="active", pid=1, host="elsewhere", boot="", source="g1.1.x.y",
            started_wall_ns=0, wall_ns=0, nominal_hz=50.0,
        )  # fmt: skip

        def alarms(rate_hz: float) -> list[str]:
            """Return the alarms once the server has said that it has this rate."""
            said = msgspec.structs.replace(health, wall_ns=bus.clock.wall_ns(), rate_hz=rate_hz)
            bus.publish({keys.server("g1"): codec.json_object(said)})

            def is_heard() -> bool:
                look.step(())
                return any(server["rate_hz"] == rate_hz for server in look.state()["servers"])

            wait_until(is_heard)
            return [alarm["text"] for alarm in look.state()["alarms"]]

        assert alarms(50.0) == []
        (late,) = alarms(41.0)
        assert late.startswith("server g1: its loop does not keep its rate")
        assert alarms(49.0) == []


def test_a_bus_that_takes_a_while_to_be_read_is_there(bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch) -> None:
    with contextlib.closing(Look(bus_server, "console")) as look:
        names = look.bus.names

        def many_names(*pattern: str) -> list[str]:
            time.sleep(0.6)  # as ten thousand take on a slow machine
            return names(*pattern)

        monkeypatch.setattr(look.bus, "names", many_names)
        look.step(())
        assert look.state()["bus"]["linked"]
