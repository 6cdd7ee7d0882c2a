from __future__ import annotations

from servers.recorder import KIND
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.server import Life


def test_what_a_server_runs_is_stated_under_its_name_and_with_its_kind(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="left", timeout_s=5.0) as bus:
        life = Life(KIND, "left", bus, "")
        try:
            life.configured({"server": "left", "rate_hz": 50})
        finally:
            life.end("test")
        stated = codec.parse_json(bus.get(keys.server_config("left")) or b"")
    assert stated == {"kind": "recorder", "server": "left", "rate_hz": 50}
