from __future__ import annotations

import math

import msgspec
import pytest

from servers.recorder import KIND
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.server import Health, Life, ServerKind, read_health
from station.life.serving import serve
from tests.waiting import DEADLINE_S


class Nothing(msgspec.Struct):
    pass


def test_what_a_server_runs_is_stated_under_its_name_and_with_its_kind(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="left", timeout_s=5.0) as bus:
        life = Life(KIND, "left", bus, "")
        try:
            life.configured({"server": "left", "rate_hz": 50})
        finally:
            life.end("test")
        stated = codec.parse_json(bus.get(keys.server_config("left")) or b"")
    assert stated == {"kind": "recorder", "server": "left", "rate_hz": 50}


def test_what_another_thread_raises_ends_the_server(bus_server: BusAddress) -> None:
    def fail() -> None:
        raise ValueError("nothing to pass on")

    def main(_config: Nothing, life: Life) -> int:
        life.clock.start(life.guarded(fail), "aside")
        assert life.stop_event.wait(DEADLINE_S)
        return 0

    kind = ServerKind(name="left", role="observer", summary="", config=Nothing, main=main)
    with pytest.raises(ValueError, match="nothing to pass on"):
        serve(kind, Nothing(), address=bus_server)
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        (health,) = read_health(bus)
    assert (health.state, health.reason) == ("finalized", "ValueError: nothing to pass on")
    assert [event.name for event in health.events] == ["server-crashed"]


@pytest.mark.parametrize(
    ("rate_hz", "nominal_hz", "is_late"),
    [(44.9, 50.0, True), (45.1, 50.0, False), (None, 50.0, False), (44.9, None, False), (0.0, 50.0, False),
     (math.nan, 50.0, False), (40.0, math.nan, False)],
)  # fmt: skip
def test_a_loop_that_has_less_than_nine_tenths_of_its_rate_is_late(
    rate_hz: float | None, nominal_hz: float | None, is_late: bool
) -> None:
    health = Health(
        name="g1", role="low-level", state="active", pid=1, host="lab", boot="b", source="g1.1.b.t", started_wall_ns=0,
        wall_ns=0, rate_hz=rate_hz, nominal_hz=nominal_hz,
    )  # fmt: skip
    assert bool(health.why_late) == is_late
