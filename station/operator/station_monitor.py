"""Everything that an operator should be told of, as events: those of the bus, and those whose server is gone.

A server that was killed says nothing, where nobody supervises it; a bus that is gone says nothing at all; and a stop
is to be heard whether a robot obeys it or not. What is read of heartbeats, the line and the stop's own key is made an
event of the usual name, so that a listener knows one kind of news.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from station.bus.client import Bus
from station.errors import BusError
from station.life import estop, events
from station.life.event_feed import EventFeed
from station.life.events import Event
from station.life.server import DEAD_AFTER_S, Health, read_health

LOOK_S = 0.5
"""Time between two looks at the heartbeats [s]; they come as often."""

_NAME = "station"  # source of what no server said
_BUS_GONE_S = 1.0


class SilenceMonitor:
    """Which servers have fallen silent without a farewell. Pure: times are given."""

    def __init__(self) -> None:
        self._heard: dict[str, tuple[int, float]] = {}  # newest word, and when it came
        self._alive: set[str] = set()
        self._told: set[str] = set()

    def on_event(self, event: Event) -> None:
        """Record a server that was already said to be gone."""
        if event.name in ("server-died", "server-silent", "server-given-up"):
            self._told.add(str(event.detail.get("server")))
        elif event.name in ("server-failed", "server-crashed"):
            self._told.add(event.source)

    def step(self, health: Iterable[Health], now_s: float) -> list[Event]:
        """Return the servers that died or came back since the last poll."""
        found = []
        for said in health:
            name, (word, heard_s) = said.name, self._heard.get(said.name, (0, now_s))
            if said.wall_ns != word:
                is_new = name in self._heard
                self._heard[name] = (said.wall_ns, now_s)
                found += self._on_health(said, is_new=is_new)
            elif name in self._alive and now_s - heard_s > DEAD_AFTER_S:
                self._alive.discard(name)
                if name not in self._told:
                    self._told.add(name)
                    found.append(_event("server-died", server=name, silent_s=round(now_s - heard_s, 1)))
        return found

    def forget(self) -> None:
        """Begin anew: no server could be heard meanwhile."""
        self._heard.clear()
        self._alive.clear()

    def _on_health(self, said: Health, *, is_new: bool) -> list[Event]:
        """Record a word; the first one may be old, and says only that there once was such a server."""
        if said.state == "finalized":
            self._alive.discard(said.name)
        elif is_new:
            self._alive.add(said.name)
            if said.name in self._told and said.state == "active":
                self._told.discard(said.name)
                return [_event("server-back", server=said.name)]
        return []


class StationMonitor:
    """Listens to a bus from now on; a context manager.

    Args:
        bus: Where everything is said.
        name: The server's own, whose heartbeat is not watched.
    """

    def __init__(self, bus: Bus, name: str = "") -> None:
        self._bus, self._name, self._clock = bus, name, bus.clock
        self._feed = EventFeed(bus)
        self._watch = bus.watch(estop.KEYS)
        self._seen = {key: self._watch.latest(key) for key in estop.KEYS}  # one from before our time is no news
        self._silence_monitor = SilenceMonitor()
        self._look_s = self._connected_s = self._clock.monotonic_s()
        self._is_lost = False

    def poll(self) -> Sequence[Event]:
        """Return what happened since the last call; never waits for the bus for long."""
        now_s = self._clock.monotonic_s()
        found = list(self._feed.pop())
        for event in found:
            self._silence_monitor.on_event(event)
        found += self._stop()
        if now_s - self._look_s >= LOOK_S:
            self._look_s = now_s
            found += self._poll_servers(now_s)
        return found

    def close(self) -> None:
        """Stop listening."""
        self._feed.close()
        self._watch.close()

    def __enter__(self) -> StationMonitor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _stop(self) -> list[Event]:
        found = []
        for key in estop.KEYS:
            sample, seen = self._watch.latest(key), self._seen[key]
            self._seen[key] = sample
            if sample is None or sample is seen or sample.arrived_ns is None:
                continue
            if (request := estop.read(sample.value, key=key)).stop:
                found.append(_event("estop", reason=request.reason))
        return found

    def _poll_servers(self, now_s: float) -> list[Event]:
        if self._watch.is_connected:
            self._connected_s = now_s
        if now_s - self._connected_s > _BUS_GONE_S:
            return self._lose()
        try:
            health = [said for said in read_health(self._bus) if said.name != self._name]
        except BusError:  # the watch will say so, if it lasts
            self._silence_monitor.forget()
            return []
        found = [_event("bus-back")] if self._is_lost else []
        self._is_lost = False
        return [*found, *self._silence_monitor.step(health, now_s)]

    def _lose(self) -> list[Event]:
        was_lost, self._is_lost = self._is_lost, True
        self._silence_monitor.forget()
        return [] if was_lost else [_event("bus-lost")]


def _event(name: str, **detail: object) -> Event:
    return events.make(_NAME, name, "warning", **detail)
