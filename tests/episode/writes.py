"""Writes as a tap delivers them: stamped ones of a native server, plain ones of a stock script."""

from __future__ import annotations

import json
import time
from typing import Any

from station.bus import keys
from station.bus.stamp import Stamp, new_source
from station.bus.tap import Write


class Native:
    """A server that stamps what it writes; every key has its own count from 1."""

    def __init__(self, name: str = "g1") -> None:
        self.source = new_source(name)
        self._sequences: dict[str, int] = {}

    def write(self, key: str, value: bytes, *, written_ns: int | None = None, capture_ns: int | None = None) -> Write:
        """One write that arrives 100 microseconds after it was made."""
        mono_ns = time.monotonic_ns() if written_ns is None else written_ns
        stamp = Stamp(self.skip(key), mono_ns, time.time_ns(), self.source, capture_ns)
        return Write(key, value, stamp.encode(), mono_ns + 100_000)

    def json(self, key: str, *, written_ns: int | None = None, **facts: Any) -> Write:
        """One write of a JSON object."""
        return self.write(key, json.dumps(facts).encode(), written_ns=written_ns)

    def skip(self, key: str) -> int:
        """Spend a sequence number: without a write of it, that write got lost."""
        self._sequences[key] = self._sequences.get(key, 0) + 1
        return self._sequences[key]

    def event(self, name: str, **detail: Any) -> Write:
        """One event, as `station.life.events` writes it."""
        return self.json(keys.EVENT, name=name, severity="info", source="g1", wall_ns=time.time_ns(), detail=detail)

    def request(self, action: str, asker: str = "", **fields: Any) -> Write:
        """One request to the recorder; its id is the action unless told otherwise."""
        return self.json(keys.RECORD, id=asker or action, action=action, **fields)


def foreign(key: str, value: bytes | None) -> Write:
    """A plain SET (or, with None, a DEL) by somebody who stamps nothing."""
    return Write(key, value, None, time.monotonic_ns())
