"""Finds the emergency stop that was overwritten or deleted before it was read. Pure.

The server tells of every write of a key, in order, but not of what was written. So writes are counted: where more were
told of than values were read, one of them may have been a stop, and counts as one. Of two writes in one pipeline, of a
write and its deletion, expiry or renaming, and of a write and a flush of the bus, the first is seen this way. The stop
has two keys (`station.life.estop`), which are counted apart; what each asks for is one story.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from station.life import estop
from station.life.estop import StopRequest

_NO_WRITES = frozenset(
    [
        *(b"del", b"expire", b"expired", b"evicted", b"persist", b"rename_from", b"move_from"),  # leave nothing new
        *(b"keymiss", b"new", b"overwritten", b"type_changed"),  # told of a read, or beside a write
    ]
)
_OVERWRITTEN = "the key of the stop was written, and overwritten before it could be read: that counts as a stop"
_REMOVED = "the key of the stop was written, and removed before it could be read: that counts as a stop"
_UNHEARD = "the key of the stop was written while the bus could not be heard: that counts as a stop"


class StopNews(NamedTuple):
    """What was asked since the last look.

    Attributes:
        request: What to do: stop, or release the stop.
        is_release_refused: Whether a release came that releases nothing, as it came before the stop was acted on.
    """

    request: StopRequest
    is_release_refused: bool = False


class StopTrace:
    """Remembers a stop until it is taken, whatever was written after it; not safe to share between threads."""

    def __init__(self) -> None:
        self._writes = Counter[str]()  # told of since a value was last read, by key
        self._news: StopNews | None = None

    def on_event(self, key: str, event: bytes) -> None:
        """Count an event of a key, by its name; one that is not known counts as a write."""
        self._writes[key] += event not in _NO_WRITES

    def may_have_missed(self, key: str, value: bytes | None) -> bool:
        """Whether a stop may be hidden behind a value that was read now: then all events must come before `on_read`."""
        return self._writes[key] > 0 and not _is_stop(key, value)

    def on_read(self, key: str, value: bytes | None, *, is_new: bool) -> None:
        """Read what a key holds.

        Args:
            key: It.
            value: What it holds; None where there is no such key.
            is_new: Whether it differs from what was read before; where the bus is polled, no event tells of a write.
        """
        writes = self._writes.pop(key, 0)
        if value is None:
            if writes:
                self._stop(_REMOVED)
        elif _is_stop(key, value):
            if writes or is_new:
                self._stop(estop.read(value, key=key).reason)
        elif writes > 1:
            self._stop(_OVERWRITTEN)
            self._release(estop.read(value))
        elif writes or is_new:
            self._release(estop.read(value))

    def on_cut(self, key: str, value: bytes | None, *, is_new: bool) -> None:
        """Read what a key holds after a time of which not every write was told."""
        if (is_new or self._writes[key]) and not _is_stop(key, value):
            self._stop(_UNHEARD)
        self.on_read(key, value, is_new=is_new)

    def begin(self) -> None:
        """Forget what came until now: for a robot that was not driven yet only what the key holds counts."""
        self._news = None

    def pop(self) -> StopNews | None:
        """Return what was asked since the last call; a stop goes before whatever came after it."""
        news, self._news = self._news, None
        return news

    @property
    def has_news(self) -> bool:
        """Whether something was asked since the last `pop`."""
        return self._news is not None

    @property
    def is_stop_pending(self) -> bool:
        """Whether it was a stop."""
        return self._news is not None and self._news.request.stop

    def _stop(self, reason: str) -> None:
        if not self.is_stop_pending:
            self._news = StopNews(StopRequest(stop=True, reason=reason))

    def _release(self, request: StopRequest) -> None:
        if self._news is not None and self._news.request.stop:
            self._news = self._news._replace(is_release_refused=True)
        else:
            self._news = StopNews(request)


def _is_stop(key: str, value: bytes | None) -> bool:
    return value is not None and estop.read(value, key=key).stop
