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


def test_what_a_loop_missed_is_a_share_of_its_periods() -> None:
    before = Health(
        name="g1", role="low-level", state="active", pid=1, host="lab", boot="b", source="g1.1.b.t", started_wall_ns=0,
        wall_ns=0, rate_hz=50.0, overruns=10,
    )  # fmt: skip
    later = msgspec.structs.replace(before, wall_ns=2_000_000_000, rate_hz=40.0, overruns=30)
    assert later.missed_since(before) == pytest.approx(20 / 100)
    assert msgspec.structs.replace(later, overruns=10).missed_since(before) == 0.0
    assert before.missed_since(before) == 0.0
    assert msgspec.structs.replace(later, rate_hz=None).missed_since(before) == 0.0, "it has no loop"
    assert msgspec.structs.replace(later, source="g1.2.b.u").missed_since(before) == 0.0, "another process"
    assert msgspec.structs.replace(later, rate_hz=-math.inf).missed_since(before) == 1.0
