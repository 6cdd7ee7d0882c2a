"""Who died, when nobody is left to say so."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from station.bus import codec, keys
from station.bus.client import Bus
from station.life import events
from station.life.events import Event
from station.life.server import DEAD_AFTER_S, Health, State
from station.operator.station_monitor import SilenceMonitor, StationMonitor
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network


def health(name: str, word: int, state: State = "active") -> Health:
    return Health(
        name=name, role="low-level", state=state, pid=0, host="elsewhere", boot="b", source="s", started_wall_ns=0,
        wall_ns=word,
    )  # fmt: skip


def names(found: list[Event]) -> list[tuple[str, str]]:
    return [(event.name, str(event.detail["server"])) for event in found]


def test_a_server_that_falls_silent_without_a_farewell_is_told_once_and_when_it_is_back() -> None:
    silence = SilenceMonitor()
    assert silence.step([health("g1", 1), health("long-gone", 1)], 0.0) == []
    assert silence.step([health("g1", 2), health("long-gone", 1)], 0.5) == []
    assert silence.step([health("g1", 2), health("long-gone", 1)], 0.5 + DEAD_AFTER_S) == []
    assert names(silence.step([health("g1", 2)], 0.6 + DEAD_AFTER_S)) == [("server-died", "g1")]
    assert silence.step([health("g1", 2)], 9.0) == []
    assert silence.step([health("g1", 3, "inactive")], 9.5) == []
    assert names(silence.step([health("g1", 4)], 10.0)) == [("server-back", "g1")]


def test_a_server_that_says_farewell_or_whose_end_was_told_is_no_news() -> None:
    silence = SilenceMonitor()
    silence.step([health("g1", 1), health("motion", 1), health("pico", 1)], 0.0)
    silence.step([health("g1", 2), health("motion", 2), health("pico", 2)], 0.5)
    silence.on_event(events.make("supervisor", "server-died", "error", server="g1"))
    silence.on_event(events.make("pico", "server-crashed", "error", reason="x"))
    found = silence.step([health("g1", 2), health("motion", 3, "finalized"), health("pico", 2)], 1.0)
    assert found + silence.step([health("g1", 2), health("motion", 3, "finalized"), health("pico", 2)], 9.0) == []


def test_after_an_outage_of_the_bus_everybody_has_time_to_speak_again() -> None:
    silence = SilenceMonitor()
    silence.step([health("g1", 1)], 0.0)
    silence.step([health("g1", 2)], 0.5)
    silence.forget()
    assert silence.step([health("g1", 2)], 20.0) == []
    assert silence.step([health("g1", 2)], 30.0) == [], "it was not heard since"


@pytest.fixture
def network() -> Iterator[Network]:
    with VirtualClock(1) as clock:
        yield Network(clock, (20_000, 200_000))


def test_a_stop_of_a_stock_script_is_heard_where_no_robot_is_there_to_say_so(network: Network) -> None:
    heard: list[Event] = []
    with Bus(network.address(), name="test", timeout_s=1.0) as bus:
        bus.call("SET", keys.ESTOP, b"1")
        with StationMonitor(bus) as monitor:
            assert list(monitor.poll()) == [], "it was pressed before our time"
            bus.call("SET", keys.ESTOP, json.dumps({"stop": False, "who": "ada"}))
            bus.publish({keys.EVENT: events.make("g1", "operator-reset", "warning", 0).encode()})
            network.clock.sleep(0.05)
            heard += monitor.poll()
            bus.call("SET", keys.ESTOP, b"stop!")
            network.clock.sleep(0.05)
            heard += monitor.poll()
    assert [event.name for event in heard] == ["operator-reset", "estop"]


@pytest.mark.parametrize(("away_s", "is_told"), [(0.5, False), (3.0, True)])
def test_a_bus_that_goes_for_long_and_comes_back_is_told_by_nobody_else(
    network: Network, away_s: float, is_told: bool
) -> None:
    heard: list[str] = []

    def hear(seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            heard.extend(event.name for event in monitor.poll())
            network.clock.sleep(0.05)

    with Bus(network.address(), name="test", timeout_s=1.0) as bus, StationMonitor(bus) as monitor:
        bus.publish({keys.server("g1"): codec.json_object(health("g1", 1))})
        hear(2.0)
        network.restart_server(away_s)
        hear(away_s)
        assert heard == (["bus-lost"] if is_told else [])
        hear(3.0)
    assert heard == (["bus-lost", "bus-back"] if is_told else [])
