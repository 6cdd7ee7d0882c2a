"""The server of Motive's stream as a process of its own: a fake Motive on real sockets, and a real bus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.devices.natnet.kind import NatnetConfig
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.servers.device_station import Station, station


@pytest.fixture
def motive(bus_server: BusAddress, tmp_path: Path) -> Iterator[Station]:
    with station("natnet", bus_server, tmp_path) as made:
        yield made


def test_a_body_stands_on_the_bus_and_what_fails_is_told_until_it_is_over(motive: Station) -> None:
    faults = (
        (1.0, "silence"),
        (2.5, ""),
        (3.5, "freeze"),
        (5.0, ""),
        (6.0, "cut"),
        (7.5, ""),
        (8.5, "too-many"),
        (10.0, ""),
    )
    steps = [{"at_s": 0.0, "motion": "builtin:wave"}, *({"at_s": at_s, "fault": fault} for at_s, fault in faults)]
    motive.start(steps)
    motive.until(lambda: motive.lasting()[:9] == ["live", *["lost", "live"] * 4])
    assert motive.samples
    assert all(sample.body is not None for sample in motive.samples)
    captured = [sample.capture_ns or 0 for sample in motive.samples]
    assert captured == sorted(set(captured)), "no old body is given again"
    reasons = [str(event.detail.get("reason")) for event in motive.events if event.name == "operator-lost"]
    assert any("sends no frames; is it live" in reason for reason in reasons)
    assert any(
        "packets could not be read, the last because of 1000000 elements announced" in reason for reason in reasons
    )
    assert motive.facts["device"]["natnet"] == "4.1"
    assert motive.stop() == 0


def test_an_actor_who_is_lost_leaves_the_device_live_and_no_body(motive: Station) -> None:
    faults = ((1.0, "untracked"), (2.0, "no-actor"), (3.0, "still"), (4.0, ""))
    steps = [{"at_s": 0.0, "motion": "builtin:wave"}, *({"at_s": at_s, "fault": fault} for at_s, fault in faults)]
    motive.start(steps)

    def is_back() -> bool:
        bodies = [bool(status.parts) for status in motive.statuses if status.state == "live"]
        return False in bodies and bodies[-1] and len(bodies) - bodies[::-1].index(False) > 50

    motive.until(lambda: len(motive.statuses) > 450 and is_back())
    assert motive.lasting() == ["live"]


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"address": "motive.local"}, "address is 'motive.local'; expected an IPv4 address such as 192.168.1.20"),
        ({"address": "192.168.1.20"}, "address is 192.168.1.20, local is 127.0.0.1: neither reaches the other"),
        ({"multicast": "10.0.0.1"}, "multicast is 10.0.0.1; expected a group such as 239.255.42.99, or nothing"),
        ({"port": 0}, "port is 0; expected 1 to 65535"),
        ({"rate_hz": 1000}, "rate_hz is 1000; expected 10 to 500 Hz"),
    ],
)
def test_bad_settings_are_one_line(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(NatnetConfig, values, where="server natnet")
    assert told in str(caught.value)
