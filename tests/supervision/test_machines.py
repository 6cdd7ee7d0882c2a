"""Servers on machines whose wall clocks differ: whether they are alive, and what the doctor says of their clocks."""

from __future__ import annotations

from typing import Any

import pytest

from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.clocks import ClockStatement
from station.life.server import Health, read_health
from station.supervision import doctor
from station.view.status import read_status_once
from tests.fuzz.parsers import health

HOUR_NS, MS = 3_600_000_000_000, 1_000_000
FAR = "0badcafe"


def _health(bus: Bus, name: str, *, ahead_ns: int = 0, **fields: Any) -> None:
    known = codec.parse_facts(health(name)) | {
        "name": name,
        "state": "active",
        "wall_ns": bus.clock.wall_ns() + ahead_ns,
    }
    bus.publish({keys.server(name): codec.json_object(known | fields)})


def _statement(bus: Bus, boot: str, *, ahead_ns: int = 0, **fields: Any) -> None:
    now_ns = bus.clock.wall_ns()
    statement = ClockStatement(
        boot=boot, host="operator-pc", mono_ns=5, wall_ns=now_ns + ahead_ns, bus_ns=now_ns, error_ns=2 * MS,
        since_bus_ns=0, comparisons=32, **({"round_trip_ns": 3 * MS} | fields),
    )  # fmt: skip
    bus.publish({keys.clock(boot): codec.json_object(statement)})


def _alive(bus: Bus) -> dict[str, bool]:
    return {each.name: each.is_alive for each in read_health(bus)}


@pytest.mark.parametrize("ahead_ns", [HOUR_NS, -HOUR_NS])
def test_a_server_on_a_machine_whose_wall_clock_is_wrong_is_alive(bus_server: BusAddress, ahead_ns: int) -> None:
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        _health(bus, "motion", boot=FAR, host="operator-pc", ahead_ns=ahead_ns)
        _health(bus, "gone", boot=FAR, host="operator-pc", ahead_ns=ahead_ns - 10_000 * MS)
        assert _alive(bus)["motion"] == (ahead_ns > 0), "nothing is known of that clock"
        _statement(bus, FAR, ahead_ns=ahead_ns)
        assert _alive(bus) == {"motion": True, "gone": False}


def test_of_a_machine_that_says_nothing_of_its_clock_the_bus_servers_is_taken(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        _health(bus, "robot", boot=FAR, host="robot")
        assert _alive(bus) == {"robot": True}


def test_the_age_of_a_key_is_by_its_writers_own_clock(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        _statement(bus, FAR, ahead_ns=HOUR_NS)
        mark = stamp.Stamp(1, 5, bus.clock.wall_ns() + HOUR_NS - 5_000 * MS, f"motion.1.{FAR}.n")
        bus.call("MSET", "some_key", b"1", keys.stamp("some_key"), mark.encode())
        (found,) = [each for each in read_status_once(bus, 0.1).keys if each.key == "some_key"]
        assert found.age_s is not None
        assert 4.9 < found.age_s < 15.0


def _clocks(bus: Bus) -> list[tuple[str, str]]:
    return [(each.level, each.found) for each in doctor._clocks(bus, [*read_health(bus)])]


def test_the_doctor_says_how_well_a_clock_is_known_and_what_follows_where_it_is_not(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        _health(bus, "g1", role="low-level", boot=stamp.boot_id())
        assert _clocks(bus) == [], "one machine"
        _health(bus, "motion", role="command", boot=FAR, host="operator-pc")
        ((level, found),) = _clocks(bus)
        assert (level, "commands of motion count by arrival alone" in found) == ("warning", True)
        _statement(bus, FAR, ahead_ns=1_500 * MS, is_synchronised=False)
        ((level, found),) = _clocks(bus)
        assert level == "ok"
        assert found == (
            "known to 2.0 ms (round trip 3.0 ms); its wall clock is +1.500 s from the bus server's, "
            "kept right by nothing"
        )


def test_the_doctor_says_where_the_bus_is_not_beside_the_robot_and_what_that_costs(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        _health(bus, "g1", role="low-level", boot=FAR, host="robot")
        _statement(bus, FAR, round_trip_ns=200_000)
        assert _clocks(bus) == []
        _statement(bus, FAR, round_trip_ns=12 * MS)
        ((level, found),) = _clocks(bus)
    assert level == "warning"
    assert found.startswith("the bus is 12.0 ms away, there and back: each command comes as much later")


def test_health_is_what_it_was_where_all_run_on_one_machine(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="test", timeout_s=5.0) as bus:
        _health(bus, "g1", boot=stamp.boot_id())
        said = codec.parse_struct(bus.get(keys.server("g1")) or b"", Health)
        assert read_health(bus) == [said]


def test_the_doctor_counts_writes_that_it_did_not_see_one_by_one(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="motion", timeout_s=5.0) as bus, bus.watch(["k"]) as watch:

        def write() -> None:
            for _ in range(10):
                bus.publish_in_turn([({"k": b"v"}, None)] * 10)
                bus.clock.sleep(0.02)

        writer = bus.clock.start(write, "writer")
        ((_, count),) = doctor._sources(watch, "k").items()
        bus.clock.join(writer)
    assert 80 <= count <= 100
