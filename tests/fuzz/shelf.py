"""A bus as a dictionary: what the parsers are given in place of a connection and of a watch."""

from __future__ import annotations

import fnmatch
import math
import time
from collections.abc import Iterable, Sequence
from typing import Any

from station.bus.address import BusAddress
from station.bus.sample import Sample
from station.clock import SYSTEM


class Shelf:
    """Values by key; answers as `station.bus.client.Bus` and `station.bus.watch.Watch` do, without any waiting."""

    is_connected = True
    address = BusAddress(host="shelf")
    clock = SYSTEM

    def __init__(self, values: dict[str, bytes]) -> None:
        self.values = values
        self._now_ns = time.monotonic_ns()

    def get(self, key: str) -> bytes | None:
        """Return a value."""
        return self.values.get(key)

    def names(self, pattern: str = "*") -> list[str]:
        """Return the keys of a pattern."""
        return fnmatch.filter(self.values, pattern)

    def read(self, keys: Iterable[str]) -> dict[str, Sample]:
        """Return the values that there are."""
        return {key: sample for key in keys if (sample := self.latest(key)) is not None}

    def call(self, *arguments: Any) -> Any:
        """Answer ``TIME`` and ``MGET``."""
        if arguments == ("TIME",):
            return [str(part).encode() for part in divmod(time.time_ns() // 1000, 1_000_000)]
        assert arguments[0] == "MGET"
        return [self.values.get(key) for key in arguments[1:]]

    def latest(self, key: str, *, max_age_s: float = math.inf) -> Sample | None:
        """Return a value as one that has just come."""
        value = self.values.get(key)
        return None if value is None else Sample(key, value, None, self._now_ns)

    def wait(self, key: str, *, after: Sample | None, timeout_s: float) -> Sample | None:
        """Return a value once, and nothing newer than it."""
        return self.latest(key) if after is None else None

    def watch(self, keys: Sequence[str]) -> Shelf:
        """Return itself: what it holds is all that comes."""
        return self

    def __enter__(self) -> Shelf:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def event(self, *_: object, **__: Any) -> None:
        """Take an event, as `station.life.server.Life` does."""

    @property
    def bus(self) -> Shelf:
        """Return itself, as a server's life has its bus."""
        return self

    name = "fake"
