"""How often each key of the bus is written, and how long ago: counted from the server's notifications."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque

import msgspec

from station.bus import keys
from station.bus.address import BusAddress, bulk_of
from station.bus.connection import Connection
from station.bus.notifications import enable_notifications
from station.errors import BusError

_WINDOW_S = 3.0


class KeyRate(msgspec.Struct, frozen=True):
    """One key.

    Attributes:
        key: The key.
        rate_hz: Writes per second over the last seconds.
        age_s: Time since the last write [s]; None when none was seen since we began to look.
        count: Writes seen since we began to look.
    """

    key: str
    rate_hz: float
    age_s: float | None
    count: int


class RateMeter:
    """Counts the writes of every key, of a bulk bus too, from a thread of its own.

    Raises:
        BusError: the bus cannot be reached, or refuses notifications.
    """

    def __init__(self, address: BusAddress) -> None:
        self._clock = address.clock
        self._link = Connection(address, timeout_s=1.0)
        if not enable_notifications(self._link):
            self._link.close()
            raise BusError(f"bus {address} refuses keyspace notifications; rates cannot be counted")
        self._prefix = f"__keyspace@{address.db}__:"
        self._link.send("PSUBSCRIBE", self._prefix + "*")
        self._link.receive(1.0)
        self._began_s = self._clock.monotonic_s()
        self._writes: dict[str, deque[float]] = {}
        self._counts: dict[str, int] = {}
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._thread = self._clock.start(self._run, "key-rates")
        self._bulk: RateMeter | None = None
        if (bulk := bulk_of(address)) is not None:
            with contextlib.suppress(BusError):  # of a bulk bus that is gone nothing is counted
                self._bulk = RateMeter(bulk)

    def rates(self) -> dict[str, KeyRate]:
        """Return the rate of every key seen so far."""
        now_s = self._clock.monotonic_s()
        span_s = min(_WINDOW_S, max(now_s - self._began_s, 1e-3))
        found = self._bulk.rates() if self._bulk is not None else {}
        with self._lock:
            return found | {key: self._rate(key, times, now_s, span_s) for key, times in self._writes.items()}

    def close(self) -> None:
        """Stop counting."""
        if self._bulk is not None:
            self._bulk.close()
        self._closed.set()
        self._clock.join(self._thread, 2.0)
        self._link.close()

    def __enter__(self) -> RateMeter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _rate(self, key: str, times: deque[float], now_s: float, span_s: float) -> KeyRate:
        recent = sum(1 for t in times if now_s - t <= span_s)
        age_s = now_s - times[-1] if times else math.inf
        return KeyRate(key, recent / span_s, age_s if math.isfinite(age_s) else None, self._counts[key])

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                message = self._link.receive(0.2)
            except TimeoutError:
                continue
            except BusError:
                return  # the bus is gone; the ages that we show grow from here
            while message is not False:
                self._count(message[2].decode("utf-8", "surrogateescape")[len(self._prefix) :])
                message = self._link.buffered()

    def _count(self, key: str) -> None:
        if keys.is_stamp(key):
            return
        now_s = self._clock.monotonic_s()
        with self._lock:
            times = self._writes.setdefault(key, deque(maxlen=4096))
            times.append(now_s)
            self._counts[key] = self._counts.get(key, 0) + 1
            while times and now_s - times[0] > 2 * _WINDOW_S:
                times.popleft()
