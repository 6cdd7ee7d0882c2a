"""What a console is told of servers whose loops do not keep their rate."""

from __future__ import annotations

import msgspec

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.server import TOO_SLOW, Health
from station.web.look import Look
from tests.waiting import wait_until


def test_a_loop_that_misses_a_tenth_of_its_periods_is_an_alarm_until_it_does_not(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="g1") as bus:
        look = Look(bus_server, "console")
        try:
            said = Health(
                name="g1", role="low-level", state="active", pid=1, host="elsewhere", boot="", source="g1.1.x.y",
                started_wall_ns=0, wall_ns=bus.clock.wall_ns(), rate_hz=50.0, overruns=7,
            )  # fmt: skip

            def alarms(*, missed: int, seconds: float) -> list[str]:
                """Return the alarms once the server has said that it missed so many periods more."""
                nonlocal said
                wall_ns = said.wall_ns + round(seconds * 1e9)
                rate_hz = (said.rate_hz or 0.0) + 0.125  # by which its news are known
                said = msgspec.structs.replace(said, overruns=said.overruns + missed, wall_ns=wall_ns, rate_hz=rate_hz)
                bus.publish({keys.server("g1"): codec.json_object(said)})

                def has_heard() -> bool:
                    look.step(())
                    return any(server["rate_hz"] == rate_hz for server in look.state()["servers"])

                wait_until(has_heard)
                return [alarm["text"] for alarm in look.state()["alarms"] if "rate" in alarm["text"]]

            assert alarms(missed=0, seconds=0.0) == []
            assert alarms(missed=300, seconds=6.0) == [f"server g1: {TOO_SLOW}"]
            assert alarms(missed=0, seconds=0.5) == [f"server g1: {TOO_SLOW}"], "it is judged over five seconds"
            assert alarms(missed=3, seconds=5.5) == []
        finally:
            look.close()
