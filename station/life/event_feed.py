"""The events of a bus, each once and one after the other, for what shows them.

Their key holds one at a time, so of two that are written within a millisecond a reader may see the second alone. What
was missed there comes with the heartbeat of the server that said it, half a second late.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator

from station.bus import keys
from station.bus.client import Bus
from station.bus.sample import Sample
from station.errors import BusError
from station.life import events
from station.life.events import Event
from station.life.server import read_health

_LOOK_S = 0.5
_MOST = 1000  # events that were not taken yet, or that are known; a server gone mad must not fill the memory


class EventFeed:
    """Gathers events from now on, in a thread of its own; a context manager."""

    def __init__(self, bus: Bus) -> None:
        self._bus, self._clock = bus, bus.clock
        self._found: deque[Event] = deque(maxlen=_MOST)
        self._known: deque[tuple[str, int, str]] = deque(maxlen=_MOST)
        self._lock = threading.Lock()
        self.look()
        self._found.clear()  # from before our time
        self._watch = bus.watch([keys.EVENT])
        self._closed = threading.Event()
        self._thread = self._clock.start(self._run, "event-feed")

    def add(self, event: Event) -> None:
        """Add an event that is known of otherwise; nothing where it is known already."""
        mark = (event.source, event.wall_ns, event.name)
        with self._lock:
            if mark not in self._known:
                self._known.append(mark)
                self._found.append(event)

    def pop(self) -> Iterator[Event]:
        """Yield the events that came since the last call."""
        while self._found:
            yield self._found.popleft()

    def close(self) -> None:
        """Stop gathering."""
        self._closed.set()
        self._watch.close()
        self._clock.join(self._thread)

    def __enter__(self) -> EventFeed:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        newest: Sample | None = None
        looked_s = self._clock.monotonic_s()
        while not self._closed.is_set():
            sample = self._watch.wait(keys.EVENT, after=newest, timeout_s=_LOOK_S)
            if sample is not None:
                newest = sample
                event = events.decode(sample.value)
                if event is not None:
                    self.add(event)
            if self._clock.monotonic_s() - looked_s >= _LOOK_S:
                looked_s = self._clock.monotonic_s()
                self.look()

    def look(self) -> None:
        """Look at the heartbeats now, which tell what was overwritten on the key."""
        try:
            found = read_health(self._bus)
        except BusError:  # the owner of a feed watches the bus as well, and tells of its loss
            return
        for event in sorted((event for health in found for event in health.events), key=lambda event: event.wall_ns):
            self.add(event)
