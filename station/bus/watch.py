"""The newest value of each watched key, at hand without a round trip.

A thread is woken by the server's keyspace notifications, reads what changed and fills one slot per key. A control
loop that looks at a slot pays microseconds, whatever the server does meanwhile. Freshness is the time since arrival
here, so it holds for stock writers without stamps and across machines whose clocks differ.
"""

from __future__ import annotations

import logging
import math
import threading
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from typing import Any, Self

from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.clocks import Clocks, Offset
from station.bus.connection import Connection, ConnectionLost, bulk, pack
from station.bus.hearing import HeardSpan, HearingProof, MissedWrites
from station.bus.notifications import (
    ASK_FLAGS,
    enable_notifications,
    flags_of,
    is_answer,
    missing_events,
    subscribe,
    taken_away,
)
from station.bus.outage import Outages
from station.bus.sample import Sample
from station.errors import BusError

log = logging.getLogger(__name__)

Read = tuple[bytes | None, stamp.Stamp | None]  # what a key holds, and its stamp
OnChange = Callable[[Collection[str]], None]  # called with the keys that were read anew

_RETRY_S = 0.05
_SHORT_S = 1.0  # a connection that lived no longer is not followed by the next one at once
_AGAIN_S = 60.0  # the same line is not logged again before
_POLL_S = 0.002  # where a server refuses notifications: five looks within one period of a 100 Hz writer
_TIMEOUT_S = 0.25
_FAR_TIMEOUT_S = 1.0  # of a server on another machine: a lost packet is sent again after 0.2 s, or 0.6 s
_IDLE_S = 1.0  # a line that was silent for so long is probed
_SOON_S = 0.001  # what is here already is taken before a server is given up
_SLACK_S = 0.15  # a busy machine answers a probe, or asks it, so much later
_ASKED = b"now"  # tells the answer of `_drain` from that of a probe


class _Changes(threading.Condition):
    """Wakes the threads that wait for a value, and counts the changes of all keys."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0


class Watch:
    """Slots with the newest value of some keys, filled by a thread of its own that reconnects by itself.

    After a cut every key is read again, since no notification came of what was written meanwhile: what changed is taken
    up as of unknown age, what was deleted stays in its slot with the age that it has.

    Args:
        address: Where the bus is.
        wanted: Keys to watch.
        outages: Account of the process, in which a cut is noted; None for none.
        clocks: Of the process, by which a write of another machine has an age; None where nobody asks for that.
        probe_s: How often it is proved that the server tells of every write [s]; `heard` is as old as that.
        changes: Those of another watch, which then wakes of what happens here too; None for its own.
        on_change: Called in its own thread, with the keys that it has read anew, for who would be woken too late in
            another one; while it runs nothing more is taken up, and it raises nothing. None for nothing.

    Attributes:
        clock: Of the arrivals; time where the bus is.
        is_connected: Whether it hears at present.
        connections: How often it began to hear; one more means that the server may have been restarted.
    """

    def __init__(
        self,
        address: BusAddress,
        wanted: Sequence[str],
        *,
        outages: Outages | None = None,
        clocks: Clocks | None = None,
        probe_s: float = _IDLE_S,
        changes: _Changes | None = None,
        on_change: OnChange | None = None,
    ) -> None:
        self._address, self.clock = address, address.clock
        self._outages, self._clocks = outages, clocks
        self._probe_s = probe_s
        self._timeout_s = _TIMEOUT_S if address.is_local else _FAR_TIMEOUT_S
        self._noticed_s = _IDLE_S + self._timeout_s  # a server that is frozen for so long is given up
        self._hearing = HearingProof(probe_s + _SLACK_S)
        self._told = MissedWrites[Read]()
        self._asked_ns = self._answered_ns = self._newest_ns = self._began_ns = 0
        self._cut_ns: int | None = None  # since when we hear nothing
        self._last_error, self._logged_s = "", -math.inf
        self._keys = tuple(dict.fromkeys(wanted))
        self._frames = {key: bulk(key) + bulk(keys.stamp(key)) for key in self._keys}
        self._look_request = pack(*ASK_FLAGS) + self._read_request(self._keys)
        self._names = {
            f"__keyspace@{address.db}__:{name}".encode("utf-8", "surrogateescape"): name
            for key in self._keys
            for name in (key, keys.stamp(key))
        }  # by the channel where their writes are told of
        self._slots: dict[str, Sample] = {}
        self._newest_mark: dict[str, stamp.Stamp | None] = {}
        self._changed, self._on_change = changes or _Changes(), on_change
        self._closed = threading.Event()
        self._armed = threading.Event()
        self.is_connected = False
        self.connections = 0
        self._events: Connection | None = None
        self._thread = self.clock.start(self._run, "bus-watch")
        self.clock.wait(self._armed, self._timeout_s * 4)  # so that a value written after this returns counts as new

    @property
    def heard(self) -> HeardSpan:
        """From when to when no write has escaped it: all that was written until then is in the slots by now.

        Where the server is polled, a foreign write of the very bytes that were there before leaves no trace.
        """
        return self._hearing.span

    def latest(self, key: str, *, max_age_s: float = math.inf) -> Sample | None:
        """Return the newest value of a key; None when there is none or it arrived longer ago than `max_age_s`."""
        sample = self._slots.get(key)
        if sample is None or (max_age_s != math.inf and sample.age_s(self.clock.monotonic_ns()) > max_age_s):
            return None
        return sample

    def wait(self, key: str, *, after: Sample | None, timeout_s: float) -> Sample | None:
        """Block until a value of a key arrives that is newer than `after`; None on time-out.

        With ``after=None`` anything that arrives from now on, or has arrived since the watch began, will do.
        """

        def newer() -> bool:
            sample = self._slots.get(key)
            return sample is not None and sample is not after and sample.arrived_ns is not None

        with self._changed:
            self.clock.wait_for(self._changed, lambda: newer() or self._closed.is_set(), timeout_s)
            return self._slots[key] if newer() else None

    def wait_any(self, after: int, timeout_s: float) -> int:
        """Block until any key holds something else than it did at a count of such changes, or for a time [s].

        Args:
            after: What the last call returned; at first 0.
            timeout_s: The time.

        Returns:
            The count now.
        """
        with self._changed:
            self.clock.wait_for(self._changed, lambda: self._changed.count != after or self._closed.is_set(), timeout_s)
            return self._changed.count

    def close(self) -> None:
        """Stop watching."""
        self._closed.set()
        with self._changed:
            self._changed.notify_all()
        if (events := self._events) is not None:
            events.hang_up()
        self.clock.join(self._thread, 2.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                self._follow()
            except BusError as error:
                was_connected, self.is_connected = self.is_connected, False
                now_s, text = self.clock.monotonic_s(), str(error)
                if not self._closed.is_set() and (text != self._last_error or now_s - self._logged_s > _AGAIN_S):
                    self._last_error, self._logged_s = text, now_s
                    log.warning("watch: %s", text)
                if was_connected:
                    self._cut_ns = self._cut_ns or self.clock.monotonic_ns()
                    if now_s - self._began_ns * 1e-9 > _SHORT_S:
                        continue  # where only the connection was cut, the next one works at once
                self.clock.wait(self._closed, _RETRY_S)

    def _follow(self) -> None:
        reader = Connection(self._address, timeout_s=self._timeout_s)
        try:
            if not enable_notifications(reader):
                self._poll(reader)
                return
            self._events = events = Connection(self._address, timeout_s=self._timeout_s)
            try:
                self._listen(events, reader)
            finally:
                self._events = None
                events.close()
        finally:
            reader.close()

    def _listen(self, events: Connection, reader: Connection) -> None:
        subscribe(events, list(self._names), self._timeout_s)
        self._fill_at_start(reader)
        self._asked_ns = self._answered_ns = self._newest_ns = self.clock.monotonic_ns()
        while not self._closed.is_set():
            message = self._next(events, reader)
            if message is None:
                continue
            self._newest_ns, answered_ns, touched = self.clock.monotonic_ns(), self._answered_ns, Counter[str]()
            while message is not False:
                self._on_message(message, touched)
                message = events.buffered()
            self._read_touched(reader, touched)
            if self._answered_ns != answered_ns:
                self._expect_told()
                self._hearing.prove(self._asked_ns, self._answered_ns)

    def _next(self, events: Connection, reader: Connection) -> Any:
        """Return the next message, or None where there is none yet; ask for answers when it is time to.

        Raises:
            ConnectionLost: the server, or one of the two lines, is frozen or gone.
        """
        now_ns = self.clock.monotonic_ns()
        is_owed = self._answered_ns < self._asked_ns
        if not is_owed and now_ns - self._asked_ns >= self._probe_s * 1e9:
            self._asked_ns, is_owed = now_ns, True
            self._read_unasked(reader)
            events.send("PING")
        wait_s = self._noticed_s - self._probe_s if is_owed else self._probe_s
        end_ns = self._asked_ns + round(wait_s * 1e9)
        try:
            return events.receive(max((end_ns - self.clock.monotonic_ns()) * 1e-9, _SOON_S))
        except TimeoutError:
            if is_owed and self.clock.monotonic_ns() >= end_ns:
                self._cut_ns = self._newest_ns
                raise ConnectionLost(f"bus {events.address}: no answer in time where writes are told of") from None
            return None

    def _read_unasked(self, reader: Connection) -> None:
        """Read all keys before a probe is sent on the other line, even if no write was reported.

        Raises:
            ConnectionLost: the server no longer tells of writes.
        """
        self._cut_ns = self._newest_ns
        reader.set_timeout(self._noticed_s - self._probe_s)
        flags, values = reader.send_packed(self._look_request, 2)
        reader.set_timeout(self._timeout_s)
        if missing_events(flags := flags_of(flags)):
            self._cut_ns = self._hearing.span.until_ns
            raise ConnectionLost(f"bus {self._address}: {taken_away(flags)}")
        self._told.record_unasked(self._decoded(self._keys, values))
        self._cut_ns = None

    def _expect_told(self) -> None:
        """After the answer to the probe, check that the server reported each change that `_read_unasked` found.

        Raises:
            ConnectionLost: the server did not report one.
        """
        if key := self._told.untold():
            self._cut_ns = self._hearing.span.until_ns
            raise ConnectionLost(
                f"bus {self._address}: {key} changed and no write was told of: some client switched notifications off "
                "for a moment, or flushed the bus"
            )

    def _on_message(self, message: Any, touched: Counter[str]) -> None:
        """Record a message: that a key was written, or the answer to a probe."""
        if isinstance(message, list) and message[0] == b"message":
            touched[self._names.get(message[1], "")] += 1
        elif self._answered_ns < self._asked_ns and is_answer(message):
            self._answered_ns = self.clock.monotonic_ns()
        else:
            raise ConnectionLost(f"bus {self._address}: {message!r} came where writes are told of")

    def _drain(self, events: Connection, touched: Counter[str]) -> None:
        """Read every message of what was written by now: all come before the answer to a question.

        Raises:
            ConnectionLost: no answer in time.
        """
        events.send("PING", _ASKED)
        while True:
            try:
                message = events.receive(self._timeout_s)
            except TimeoutError:
                raise ConnectionLost(f"bus {events.address}: no answer in time where writes are told of") from None
            is_probe_owed = self._answered_ns < self._asked_ns
            if message == [b"pong", _ASKED] or (isinstance(message, Exception) and not is_probe_owed):
                return
            self._on_message(message, touched)

    def _poll(self, reader: Connection) -> None:
        log.warning("bus %s: no keyspace notifications; polling every %.0f ms", self._address, _POLL_S * 1e3)
        self._fill_at_start(reader)
        everything = Counter(self._names.values())
        while not self.clock.wait(self._closed, _POLL_S):
            asked_ns = self.clock.monotonic_ns()
            self._read_touched(reader, everything)
            self._hearing.prove(asked_ns, self.clock.monotonic_ns())

    def _fill_at_start(self, reader: Connection) -> None:
        """Read what is there already, as of unknown age; after a lost connection keep what we had."""
        values = self._fetch(reader, self._keys)
        with self._changed:
            for key, (value, mark) in values.items():
                self._newest_mark[key] = mark
                known = self._slots.get(key)
                if value is not None and (known is None or (known.value, known.stamp) != (value, mark)):
                    self._slots[key] = Sample(key, value, mark, None)
        if self._cut_ns is not None and self._outages is not None:
            self._outages.record("watch-back", self._cut_ns, reason=self._last_error)
        self._cut_ns, self._began_ns = None, self.clock.monotonic_ns()
        self._hearing.begin(self._began_ns)
        self.connections += 1
        self.is_connected = True
        self._armed.set()
        if self._on_change is not None:
            self._on_change(self._keys)

    def _read_touched(self, reader: Connection, touched: Counter[str]) -> None:
        wanted = [key for key in self._keys if key in touched or keys.stamp(key) in touched]
        values = self._fetch(reader, wanted)
        now_ns = self.clock.monotonic_ns()
        with self._changed:
            for key, (value, mark) in values.items():
                self._put(key, value, mark, now_ns, is_foreign=touched[key] > touched[keys.stamp(key)])
            self._changed.notify_all()
        if values and self._on_change is not None:
            self._on_change(wanted)

    def _put(self, key: str, value: bytes | None, mark: stamp.Stamp | None, now_ns: int, *, is_foreign: bool) -> None:
        known = self._slots.get(key)
        if value is None:
            self._slots.pop(key, None)
        elif known is None or mark != self._newest_mark.get(key):
            self._slots[key] = Sample(key, value, mark, now_ns, self._clock_of(mark))
        elif is_foreign or value != known.value:
            # The stamp stands still while the value is written: a stock script overwrites a native key.
            self._slots[key] = Sample(key, value, None, now_ns)
        self._changed.count += self._slots.get(key) is not known
        self._newest_mark[key] = mark

    def _clock_of(self, mark: stamp.Stamp | None) -> Offset | None:
        """Return how the clock of a writer on another machine is to be read here, where that is known."""
        if mark is None or self._clocks is None or mark.is_from_this_boot:
            return None
        return self._clocks.offset_of(stamp.boot_of(mark.source))

    def _fetch(self, reader: Connection, wanted: Sequence[str]) -> dict[str, Read]:
        if not wanted:
            return {}
        values = self._decoded(wanted, reader.send_packed(self._read_request(wanted))[0])
        self._told.record_read(values)
        return values

    def _read_request(self, wanted: Sequence[str]) -> bytes:
        return b"*%d\r\n$4\r\nMGET\r\n" % (1 + 2 * len(wanted)) + b"".join([self._frames[key] for key in wanted])

    def _decoded(self, wanted: Sequence[str], values: Any) -> dict[str, Read]:
        if isinstance(values, Exception):
            raise BusError(f"bus {self._address}: {values}")
        marks = (stamp.decode(mark) if mark else None for mark in values[1::2])
        return dict(zip(wanted, zip(values[::2], marks, strict=True), strict=True))


class WatchOfBoth(Watch):
    """A watch of keys of a bus, and of some that are on its bulk bus; what it says of itself it says of the bus.

    Args:
        address, wanted, outages, clocks, on_change: As of `Watch`; the last is called by two threads.
        bulk: Where the bulk bus is.
    """

    def __init__(
        self,
        address: BusAddress,
        wanted: Sequence[str],
        *,
        bulk: BusAddress,
        outages: Outages,
        clocks: Clocks,
        on_change: OnChange | None,
    ) -> None:
        here, there = ([key for key in wanted if keys.is_bulk(key) == is_bulk] for is_bulk in (False, True))
        super().__init__(address, here, outages=outages, clocks=clocks, on_change=on_change)
        self._bulk = Watch(
            bulk, there, outages=outages, clocks=clocks, changes=self._changed, on_change=on_change
        )  # fmt: skip

    def latest(self, key: str, *, max_age_s: float = math.inf) -> Sample | None:
        """As `Watch.latest`."""
        found = self._bulk.latest if keys.is_bulk(key) else super().latest
        return found(key, max_age_s=max_age_s)

    def wait(self, key: str, *, after: Sample | None, timeout_s: float) -> Sample | None:
        """As `Watch.wait`."""
        found = self._bulk.wait if keys.is_bulk(key) else super().wait
        return found(key, after=after, timeout_s=timeout_s)

    def close(self) -> None:
        """Stop watching."""
        self._bulk.close()
        super().close()
