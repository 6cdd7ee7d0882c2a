"""What a process suffered from its bus: silences, losses, refusals. Each is told once, when it is over.

While it lasts it cannot be told; so it carries when it began, and is told later with how long ago that was.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Any, Literal, NamedTuple

from station.clock import SYSTEM, Clock

_SETTLE_NS = 1_000_000_000  # a recorder has tapped a restarted server again by then, and hears what is told
_MOST = 100  # that were not told yet
_REMEMBERED = 8

Kind = Literal["bus-silent", "bus-back", "bus-refused", "watch-back"]


class Outage(NamedTuple):
    """One of them, over.

    Attributes:
        kind: ``bus-silent``: the server owed an answer for so long, and then gave it. ``bus-back``: the connection was
            lost, and is there again. ``bus-refused``: the server answered writes with an error. ``watch-back``: only
            the line on which a watch hears was cut.
        began_ns, ended_ns: From when to when, on this process's monotonic clock [ns].
        numbers: What else there is to tell.
    """

    kind: Kind
    began_ns: int
    ended_ns: int
    numbers: dict[str, Any]

    def detail(self, now_ns: int) -> dict[str, Any]:
        """Return what an event says of it: its length, how long ago it began [s], and its numbers."""
        seconds, ago_s = (self.ended_ns - self.began_ns) * 1e-9, (now_ns - self.began_ns) * 1e-9
        return {"seconds": round(seconds, 3), "began_ago_s": round(ago_s, 3), **self.numbers}

    def meets(self, other: Outage) -> bool:
        """Whether two of them share an instant."""
        return self.began_ns <= other.ended_ns and other.began_ns <= self.ended_ns


class Outages:
    """Gathers the outages of one process; safe to share between its threads.

    Args:
        clock: The process's.
    """

    def __init__(self, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._held: deque[Outage] = deque(maxlen=_MOST)
        self._told: deque[Outage] = deque(maxlen=_REMEMBERED)

    def record(self, kind: Kind, began_ns: int, **numbers: Any) -> None:
        """Record one that ends now."""
        with self._lock:
            self._held.append(Outage(kind, began_ns, self._clock.monotonic_ns(), numbers))

    def pop(self) -> list[Outage]:
        """Return those that have been over for a second, oldest first, each once.

        A watch that fell silent together with the whole bus, or with another watch, is not told of again.
        """
        now_ns = self._clock.monotonic_ns()
        with self._lock:
            due = [outage for outage in self._held if now_ns - outage.ended_ns >= _SETTLE_NS]
            known = [*self._told, *(outage for outage in self._held if outage.kind != "watch-back")]
            self._held = deque((outage for outage in self._held if outage not in due), maxlen=_MOST)
            found: list[Outage] = []
            for outage in due:
                if outage.kind != "watch-back" or not any(outage.meets(other) for other in [*known, *found]):
                    found.append(outage)
            self._told.extend(found)
        return found
