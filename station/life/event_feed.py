"""The events of a bus, one after the other, for whoever shows them.

The key holds one event at a time, so two that are written within a millisecond may show as the second alone; the
recorder, which follows every write, has both.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator

from station.bus import keys
from station.bus.client import Bus
from station.bus.sample import Sample
from station.life import events
from station.life.events import Event

_WAIT_S = 0.5
_MOST = 1000  # events that nobody has taken; a server gone mad must not fill the memory


class EventFeed:
    """Gathers events from now on, in a thread of its own; a context manager."""

    def __init__(self, bus: Bus) -> None:
        self._watch = bus.watch([keys.EVENT])
        self._found: deque[Event] = deque(maxlen=_MOST)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="event-feed", daemon=True)
        self._thread.start()

    def take(self) -> Iterator[Event]:
        """Yield the events that came since the last call."""
        while self._found:
            yield self._found.popleft()

    def close(self) -> None:
        """Stop gathering."""
        self._closed.set()
        self._watch.close()
        self._thread.join()

    def __enter__(self) -> EventFeed:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        newest: Sample | None = None
        while not self._closed.is_set():
            sample = self._watch.wait(keys.EVENT, after=newest, timeout_s=_WAIT_S)
            if sample is not None:
                newest = sample
                event = events.decode(sample.value)
                if event is not None:
                    self._found.append(event)
