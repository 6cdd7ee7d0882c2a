"""Who died, when nobody is left to say so."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.life import events
from station.life.events import Event
from station.life.server import DEAD_AFTER_S, Health, State
from station.operator.onlooker import Onlooker, Vigil
from tests.waiting import wait_until


def health(name: str, word: int, state: State = "active") -> Health:
    return Health(
        name=name, role="low-level", state=state, pid=0, host="elsewhere", boot="b", source="s", started_wall_ns=0,
        wall_ns=word,
    )  # fmt: skip


def names(found: list[Event]) -> list[tuple[str, str]]:
    return [(event.name, str(event.detail["server"])) for event in found]


def test_a_server_that_falls_silent_without_a_farewell_is_told_once_and_when_it_is_back() -> None:
    vigil = Vigil()
    assert vigil.step([health("g1", 1), health("long-gone", 1)], 0.0) == []
    assert vigil.step([health("g1", 2), health("long-gone", 1)], 0.5) == []
    assert vigil.step([health("g1", 2), health("long-gone", 1)], 0.5 + DEAD_AFTER_S) == []
    assert names(vigil.step([health("g1", 2)], 0.6 + DEAD_AFTER_S)) == [("server-died", "g1")]
    assert vigil.step([health("g1", 2)], 9.0) == []
    assert vigil.step([health("g1", 3, "inactive")], 9.5) == []
    assert names(vigil.step([health("g1", 4)], 10.0)) == [("server-back", "g1")]


def test_a_server_that_says_farewell_or_whose_end_was_told_is_no_news() -> None:
    vigil = Vigil()
    vigil.step([health("g1", 1), health("motion", 1), health("pico", 1)], 0.0)
    vigil.step([health("g1", 2), health("motion", 2), health("pico", 2)], 0.5)
    vigil.hear(events.make("supervisor", "server-died", "error", server="g1"))
    vigil.hear(events.make("pico", "server-crashed", "error", reason="x"))
    found = vigil.step([health("g1", 2), health("motion", 3, "finalized"), health("pico", 2)], 1.0)
    assert found + vigil.step([health("g1", 2), health("motion", 3, "finalized"), health("pico", 2)], 9.0) == []


def test_after_an_outage_of_the_bus_everybody_has_time_to_speak_again() -> None:
    vigil = Vigil()
    vigil.step([health("g1", 1)], 0.0)
    vigil.step([health("g1", 2)], 0.5)
    vigil.forget()
    assert vigil.step([health("g1", 2)], 20.0) == []
    assert vigil.step([health("g1", 2)], 30.0) == [], "it was not heard since"


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="test", timeout_s=5.0) as client:
        yield client


def test_a_stop_of_a_stock_script_is_heard_where_no_robot_is_there_to_say_so(bus: Bus) -> None:
    bus.call("SET", keys.ESTOP, b"1")
    heard: list[Event] = []
    with Onlooker(bus) as onlooker:
        assert list(onlooker.take()) == [], "it was pressed before our time"
        bus.call("SET", keys.ESTOP, json.dumps({"stop": False, "who": "ada"}))
        bus.publish({keys.EVENT: events.make("g1", "operator-reset", "warning").encode()})
        wait_until(lambda: heard.extend(onlooker.take()) or heard)
        bus.call("SET", keys.ESTOP, b"stop!")
        wait_until(lambda: heard.extend(onlooker.take()) or len(heard) > 1)
    assert [event.name for event in heard] == ["operator-reset", "estop"]


@pytest.mark.usefixtures("processes")
def test_a_bus_that_goes_and_comes_back_is_told_by_nobody_else(tmp_path_factory: pytest.TempPathFactory) -> None:
    options = ServerOptions(folder=tmp_path_factory.mktemp("b"), socket=tmp_path_factory.mktemp("s") / "bus.sock")
    server = RedisServer.start(options)
    heard: list[str] = []
    with Bus(server.address, name="test", timeout_s=5.0) as bus, Onlooker(bus) as onlooker:
        bus.publish({keys.server("g1"): codec.json_object(health("g1", 1))})
        server.stop()
        wait_until(lambda: heard.extend(event.name for event in onlooker.take()) or "bus-lost" in heard)
        again = RedisServer.start(options)
        wait_until(lambda: heard.extend(event.name for event in onlooker.take()) or "bus-back" in heard)
        again.stop()
    assert heard == ["bus-lost", "bus-back"]
