"""A feed of what all servers say: each event once, however fast they speak."""

from __future__ import annotations

from contextlib import ExitStack

import msgspec
import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life import event_publisher, events
from station.life.event_feed import EventFeed
from station.life.server import Life, ServerKind, read_health
from tests.waiting import DEADLINE_S, wait_until

KIND = ServerKind(name="a", role="command", summary="", config=msgspec.Struct, main=lambda _config, _life: 0)


def test_a_feed_misses_no_event_however_fast_several_servers_speak(
    bus_server: BusAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_publisher, "RECENT_S", DEADLINE_S)
    with ExitStack() as stack:
        lines = {name: stack.enter_context(Bus(bus_server, name=name, timeout_s=5.0)) for name in ("a", "b", "c", "d")}
        lives = {name: Life(KIND, name, line, "") for name, line in lines.items()}
        lives["a"].event("from before")
        wait_until(lambda: any(health.events for health in read_health(lines["a"])))
        feed = stack.enter_context(EventFeed(lines["a"]))
        said = [(name, f"{name}-{number}") for number in range(20) for name in lives]
        for name, event in said:
            lives[name].event(event)
        found: list[tuple[str, str]] = []
        wait_until(lambda: found.extend((event.source, event.name) for event in feed.pop()) or len(found) >= len(said))
        for life in lives.values():
            life.end("over")
        wait_until(lambda: all(health.state == "finalized" for health in read_health(lines["a"])))
        found.extend((event.source, event.name) for event in feed.pop())
        assert sorted(found) == sorted(said)


def test_a_feed_yields_each_event_once_and_survives_junk(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="a", timeout_s=5.0) as bus, EventFeed(bus) as feed:
        found: list[str] = []
        for name in ("one", "two", "three"):
            bus.call("SET", keys.EVENT, b'{"name": "\xff"}')
            bus.publish({keys.EVENT: events.make("a", name).encode()})
            wait_until(lambda: found.extend(event.name for event in feed.pop()) or len(found) > 0)
            assert found.pop() == name
        assert list(feed.pop()) == []
