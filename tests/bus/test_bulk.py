"""A second server for depth and clouds: what goes where, who finds it, and what its death costs."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from station.bus import address as addresses
from station.bus import keys
from station.bus.address import BULK_VARIABLE, ENVIRONMENT_VARIABLE, NO_BULK, BusAddress, bulk_beside, bulk_of, parse
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.keeper import KeptServer
from station.bus.redis_server import RedisServer, remove_dead
from station.bus.server_options import ServerOptions, bulk_options
from station.errors import BusError, ConfigError
from station.view.rates import RateMeter
from tests.waiting import bus_answers, wait_until

DEPTH, COLOUR, CLOUD = keys.camera_depth("head"), keys.camera_image("head"), keys.lidar_cloud("top")


@pytest.fixture
def options(tmp_path: Path) -> ServerOptions:
    return ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock", password="secret")


@pytest.fixture
def bus(options: ServerOptions, processes: None) -> Iterator[BusAddress]:
    with RedisServer.start(options) as server:
        yield server.address


@pytest.fixture
def bulk(bus: BusAddress, options: ServerOptions) -> Iterator[KeptServer]:
    with KeptServer.start(bulk_options(options)) as server:
        yield server


def holds(address: BusAddress, key: str) -> bytes | None:
    line = Connection(address, timeout_s=1.0)
    try:
        value: bytes | None = line.call("GET", key)
        return value
    finally:
        line.close()


def test_depth_and_clouds_go_over_the_bulk_bus_and_all_else_over_the_bus(bus: BusAddress, bulk: KeptServer) -> None:
    with Bus(bus, name="head", timeout_s=1.0) as line:
        assert line.publish({COLOUR: b"jpeg", DEPTH: b"png", CLOUD: b"cloud", keys.lidar_imu("top"): b"imu"})
        held = {key: (holds(bus, key), holds(bulk.address, key)) for key in (COLOUR, DEPTH, CLOUD)}
        assert held == {COLOUR: (b"jpeg", None), DEPTH: (None, b"png"), CLOUD: (None, b"cloud")}
        assert holds(bus, keys.lidar_imu("top")) == b"imu"


def test_who_reads_a_key_need_not_know_where_it_is(bus: BusAddress, bulk: KeptServer) -> None:
    with Bus(bus, name="head", timeout_s=1.0) as head, Bus(bus, name="view", timeout_s=1.0) as line:
        with line.watch([COLOUR, DEPTH]) as watch, line.watch([CLOUD]) as clouds, RateMeter(bus) as meter:
            count = watch.wait_any(0, 0.0)
            head.publish({DEPTH: b"png"}, capture_ns=7)
            assert watch.wait_any(count, 10.0) > count
            head.publish({COLOUR: b"jpeg", CLOUD: b"cloud"})
            seen = [watch.wait(DEPTH, after=None, timeout_s=10.0), watch.wait(COLOUR, after=None, timeout_s=10.0),
                    clouds.wait(CLOUD, after=None, timeout_s=10.0)]  # fmt: skip
            assert [sample and sample.value for sample in seen] == [b"png", b"jpeg", b"cloud"]
            assert seen[0] is not None
            assert seen[0].stamp is not None
            assert (seen[0].stamp.writer, seen[0].stamp.capture_ns) == ("head", 7)
            wait_until(lambda: {COLOUR, DEPTH, CLOUD} <= set(meter.rates()))
        assert line.names() == line.names("*_*") == sorted([COLOUR, DEPTH, CLOUD])
        assert line.get(CLOUD) == b"cloud"
        assert {key: sample.value for key, sample in line.read([COLOUR, DEPTH]).items()} == {
            COLOUR: b"jpeg", DEPTH: b"png",
        }  # fmt: skip


def test_who_wrote_depth_is_told_as_of_any_key(bus: BusAddress, bulk: KeptServer) -> None:
    with Bus(bus, name="head", timeout_s=5.0) as line:
        line.publish({DEPTH: b"png", COLOUR: b"jpeg"})
        told = line.stamps([*line.names(), "nothing"])
        assert {key: mark.writer if mark else None for key, mark in told.items()} == {
            DEPTH: "head", COLOUR: "head", "nothing": None,
        }  # fmt: skip


def test_without_a_second_server_all_goes_over_the_bus(bus: BusAddress) -> None:
    with Bus(bus, name="head", timeout_s=1.0) as line:
        assert line.bulk_address is None
        assert line.open_bulk() is line
        assert line.publish({COLOUR: b"jpeg", DEPTH: b"png"})
        assert holds(bus, DEPTH) == b"png"


def test_its_death_is_told_and_counted_and_touches_nothing_on_the_bus(bus: BusAddress, bulk: KeptServer) -> None:
    with Bus(bus, name="head", timeout_s=1.0) as line:
        assert line.publish({DEPTH: b"1"})
        os.kill(bulk.pid, signal.SIGKILL)
        wait_until(lambda: not line.publish({COLOUR: b"jpeg", DEPTH: b"2"}))
        assert line.is_connected
        assert line.connections == 1
        assert line.lost_writes >= 1
        wait_until(lambda: line.publish({DEPTH: b"3"}))
        assert (holds(bus, COLOUR), holds(bulk.address, DEPTH)) == (b"jpeg", b"3")
        told = []
        wait_until(lambda: told.extend(line.outages.pop()) or told)
        assert [(outage.kind, outage.numbers["bus"]) for outage in told] == [("bus-back", "bulk")]
    assert bulk.restarts == 1


def test_its_socket_stays_while_it_is_started_again(bus: BusAddress, options: ServerOptions) -> None:
    """A process that starts meanwhile must not believe that there is none."""
    dead = RedisServer.start(bulk_options(options))
    os.kill(dead.pid, signal.SIGKILL)
    wait_until(lambda: not dead.is_running)
    assert bulk_of(bus) is not None
    with Bus(bus, name="head", timeout_s=1.0) as line:
        with pytest.raises(BusError, match=r"depth and clouds go there: start it again .*--bulk") as caught:
            line.publish({DEPTH: b"png"})
        assert line.publish({COLOUR: b"jpeg"})
    assert "\n" not in str(caught.value)
    with RedisServer.start(bulk_options(options)) as again:
        assert bus_answers(again.address)
    assert bulk_of(bus) is None


def test_the_socket_of_one_that_is_gone_for_good_is_removed(bus: BusAddress, options: ServerOptions) -> None:
    with RedisServer.start(bulk_options(options)) as server:
        remove_dead(bulk_beside(str(bus.socket)))
        assert bulk_of(bus) is not None, "it lives"
        os.kill(server.pid, signal.SIGKILL)
        wait_until(lambda: not server.is_running)
        remove_dead(bulk_beside(str(bus.socket)))
        assert bulk_of(bus) is None


def test_it_takes_no_processor_from_the_bus(bus: BusAddress, bulk: KeptServer) -> None:
    assert os.sched_getscheduler(bulk.pid) == os.SCHED_OTHER


def test_it_is_opened_to_other_machines_on_the_next_port(options: ServerOptions) -> None:
    shared = replace(options, bind="10.0.0.1", tcp_port=6379)
    found = bulk_options(shared)
    assert (found.bind, found.tcp_port, found.password) == ("10.0.0.1", 6380, "secret")
    assert bulk_options(replace(options, tcp_port=6379)).tcp_port is None, "stock scripts know of none"
    with pytest.raises(ConfigError, match="none is behind 65535"):
        bulk_options(replace(shared, tcp_port=65535))


def test_the_environment_names_one_of_the_default_bus_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, "redis://recorder:pw@robot:6379/0")
    monkeypatch.setenv(BULK_VARIABLE, "redis://robot:6380/0")
    found = bulk_of(addresses.default())
    assert found is not None
    assert (str(found), found.username, found.password) == ("redis://robot:6380/0", "recorder", "pw")
    assert bulk_of(parse("redis://another:6379/0")) is None
    monkeypatch.setenv(BULK_VARIABLE, "redis://robot:6379/0")
    assert bulk_of(addresses.default()) is None, "the bus itself"


def test_the_environment_may_say_that_there_is_none(
    bus: BusAddress, bulk: KeptServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, bus.url)
    assert bulk_of(bus) is not None
    monkeypatch.setenv(BULK_VARIABLE, NO_BULK)
    assert bulk_of(bus) is None
