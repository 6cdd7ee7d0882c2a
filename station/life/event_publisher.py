"""Says the events of a server: on the bus, in the log, and once more with its heartbeats.

The bus holds one event at a time; of two that are written within a millisecond a reader may see the second alone. So
each stands in the server's heartbeats too, for a few seconds: a reader of both (`station.life.event_feed`) misses none.
"""

from __future__ import annotations

import logging
from collections import deque
from typing import Any

from station.bus import keys
from station.bus.client import Bus
from station.life import events
from station.life.events import Event, Severity

log = logging.getLogger(__name__)

RECENT_S = 3.0
"""So long an event stands in the heartbeats [s]: in five of them, and a reader looks as often as they come."""

_MOST_RECENT = 32
_MOST_UNSAID = 100


class EventPublisher:
    """Says what happens to one server.

    Args:
        bus: Where it is said.
        source: Name of the server.
    """

    def __init__(self, bus: Bus, source: str) -> None:
        self._bus, self._clock, self._source = bus, bus.clock, source
        self._recent: deque[Event] = deque(maxlen=_MOST_RECENT)
        self._unsaid: deque[Event] = deque(maxlen=_MOST_UNSAID)  # what the bus did not take

    @property
    def recent(self) -> list[Event]:
        """What was said in the last few seconds, oldest first."""
        since_ns = self._clock.wall_ns() - round(RECENT_S * 1e9)
        return [event for event in tuple(self._recent) if event.wall_ns > since_ns]

    def publish(self, name: str, severity: Severity, **detail: Any) -> None:
        """Publish an event; where the bus does not take it, `publish_late` does so again."""
        event = events.make(self._source, name, severity, self._clock.wall_ns(), **detail)
        self._recent.append(event)
        if not self._bus.publish({keys.EVENT: event.encode()}):
            self._unsaid.append(event)
        events.write_log(log, event)

    def publish_unlogged(self, name: str, severity: Severity, **detail: Any) -> None:
        """Publish an event that another process prints."""
        event = events.make(self._source, name, severity, self._clock.wall_ns(), **detail)
        self._recent.append(event)
        self._bus.publish({keys.EVENT: event.encode()})

    def publish_late(self) -> None:
        """Publish the events that the bus did not take, now that it is back and its readers listen again."""
        while self._unsaid:
            event = self._unsaid[0]
            if not self._bus.publish({keys.EVENT: events.late(event, self._clock.wall_ns()).encode()}):
                return
            self._unsaid.popleft()
