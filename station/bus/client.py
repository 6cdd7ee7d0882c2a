"""A process's own line to the bus: atomic stamped writes, bounded waits, reconnection in the background."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import TracebackType
from typing import Any

import hiredis

from station.bus import address as addresses
from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.clocks import Clocks
from station.bus.connection import Argument, Connection, ConnectionLost, bulk
from station.bus.outage import Kind, Outages
from station.bus.sample import Sample
from station.bus.stamp import Stamp
from station.bus.watch import OnChange, Watch, WatchOfBoth
from station.clock import Clock
from station.errors import BusError


class StampedWrites:
    """The writes of one source; not safe to share between threads.

    Args:
        source: Stands in every stamp.
        clock: Its instants stand in every stamp.
    """

    def __init__(self, source: str, clock: Clock) -> None:
        self._source, self._clock = source, clock
        self._sequences: dict[str, int] = {}
        self._frames: dict[str, tuple[bytes, bytes]] = {}  # name of a key and of its stamp, as they are sent

    def encode(self, values: Mapping[str, bytes], capture_ns: int | None) -> bytes:
        """Return the request that writes values by key now; it spends a number of each key.

        Args:
            values: Bytes by key.
            capture_ns: A device's own time of capture [ns], for the stamps.
        """
        mono_ns, wall_ns = self._clock.monotonic_ns(), self._clock.wall_ns()
        parts = [b"*%d\r\n$4\r\nMSET\r\n" % (1 + 4 * len(values))]
        for key, value in values.items():
            seq = self._sequences[key] = self._sequences.get(key, 0) + 1
            mark = stamp.Stamp(seq, mono_ns, wall_ns, self._source, capture_ns).encode()
            frame, stamp_frame = self._frames.get(key) or self._frame(key)
            parts += (
                frame,
                b"$%d\r\n" % len(value),
                value,
                b"\r\n",
                stamp_frame,
                b"$%d\r\n" % len(mark),
                mark,
                b"\r\n",
            )
        return b"".join(parts)

    def _frame(self, key: str) -> tuple[bytes, bytes]:
        frames = (bulk(key), bulk(keys.stamp(key)))
        self._frames[key] = frames
        return frames


log = logging.getLogger(__name__)

_STALL_S = 5.0  # a busy machine may hold a server up for a moment; one silent for longer is taken for frozen
_SILENT_S = 0.5  # a silence worth telling of: a gate has begun to return by then, and no busy machine is that slow
_VAIN_S = 0.04  # an answer that is owed for less is on its way
_FAR_TIMEOUT_S = 1.0  # over a network that loses packets: one that is sent again comes 0.2 s later, or 0.6 s
_RETRY_S = 0.05  # a restarted local server is back within 25 ms, and a gate returns after 300; a try costs 0.1 ms


class Bus:
    """A connection under a server's name; safe to share between the threads of a process.

    Args:
        address: Where the bus is; None takes `station.bus.address.default`.
        name: Name that stands in every stamp this object writes.
        timeout_s: Longest wait for any answer [s].
        bulk_of: The bus that this one is the bulk bus of; outages are told there, and clocks are taken from there.

    Depth and clouds (`keys.is_bulk`) go to the bulk bus, where the station has one, and are read there: whoever
    publishes, reads or watches a key need not know where it is.

    Attributes:
        clock: Time where the bus is.
        connections: How often this object was connected; one more means that the server may have forgotten us.
        outages: What this process suffered from the bus, its watches included.
        clocks: Of this machine and of others that write to the bus.

    Raises:
        BusError: the server cannot be reached or refuses us.
    """

    def __init__(
        self, address: BusAddress | None = None, *, name: str, timeout_s: float = 0.05, bulk_of: Bus | None = None
    ) -> None:
        self.address = address or addresses.default()
        self.clock = self.address.clock
        self.source = stamp.new_source(name)
        self.last_error = ""
        self.connections = 1
        self.outages: Outages = Outages(self.clock) if bulk_of is None else bulk_of.outages
        self.clocks: Clocks = Clocks(self.address) if bulk_of is None else bulk_of.clocks
        self._is_bulk = bulk_of is not None
        self._bulk: Bus | None = None
        self._bulk_lock = self.clock.lock()
        self._name = name
        self._lost_writes = 0
        self._is_far = not self.address.is_local
        self._timeout_s = self._patience_s(timeout_s)
        self._lock = self.clock.lock()
        self._closed = threading.Event()
        self._writes = StampedWrites(self.source, self.clock)
        self._unanswered: deque[int] = deque()  # keys per write whose answer is owed
        self._heard_s = self.clock.monotonic_s()  # when the server last answered, or owed nothing
        self._looks_in_vain = 0  # for answers that are owed, since the server was last heard
        self._refused, self._refused_s = 0, 0.0  # writes in a row that were answered with an error, and since when
        self._connection: Connection | None = Connection(self.address, timeout_s=max(timeout_s, 1.0))
        self._connection.set_timeout(self._timeout_s)

    @cached_property
    def bulk_address(self) -> BusAddress | None:
        """Where the bulk bus is; None where there is none. Found when it is first needed: a stop needs it never.

        Raises:
            ConfigError: what names it is no address.
        """
        return None if self._is_bulk else addresses.bulk_of(self.address)

    @property
    def is_connected(self) -> bool:
        """Whether the last thing we know of the server is that it answered."""
        return self._connection is not None

    @property
    def lost_writes(self) -> int:
        """Keys that were published and did not reach the server, as far as is known; of the bulk bus too."""
        return self._lost_writes + (self._bulk.lost_writes if self._bulk is not None else 0)

    @property
    def is_late(self) -> bool:
        """Whether the server owes the answer to a write."""
        return bool(self._unanswered)

    def set_timeout(self, timeout_s: float) -> None:
        """Set the longest wait for any answer [s]."""
        with self._lock:
            self._timeout_s = self._patience_s(timeout_s)
            if self._connection is not None:
                self._connection.set_timeout(self._timeout_s)
        if self._bulk is not None:
            self._bulk.set_timeout(timeout_s)

    def open_bulk(self) -> Bus:
        """Return the line to the bulk bus, which is opened once; this one where the station has none.

        Raises:
            BusError: the bulk bus cannot be reached, or refuses us.
        """
        if self.bulk_address is None:
            return self
        with self._bulk_lock:
            if self._bulk is None:
                try:
                    self._bulk = Bus(self.bulk_address, name=self._name, timeout_s=self._timeout_s, bulk_of=self)
                except BusError as error:
                    why = str(error).partition("; does a station run")[0].removeprefix("bus ")
                    raise BusError(
                        f"bulk bus {why}; depth and clouds go there: start it again (`station bus start --bulk`), or "
                        f"set ${addresses.BULK_VARIABLE}={addresses.NO_BULK}"
                    ) from None
            return self._bulk

    def lines(self, values: Mapping[str, bytes]) -> list[tuple[Bus, Mapping[str, bytes]]]:
        """Return values with the lines that they go by.

        Raises:
            BusError: some go by the bulk bus, and that was never reached.
        """
        if not any(map(keys.is_bulk, values)) or self.bulk_address is None:
            return [(self, values)]
        near = {key: value for key, value in values.items() if not keys.is_bulk(key)}
        there = {key: value for key, value in values.items() if keys.is_bulk(key)}
        return [*([(self, near)] if near else []), (self.open_bulk(), there)]

    def publish(self, values: Mapping[str, bytes], *, capture_ns: int | None = None) -> bool:
        """Write keys and their stamps as one atomic command; as two where some go over the bulk bus.

        Args:
            values: Bytes by key.
            capture_ns: A device's own time of capture [ns], for the stamps.

        Returns:
            Whether it is on its way: taken by the server, or handed to one that answers late. When not, the writes
            count as lost (their sequence numbers are spent, so a recording shows the hole) and the connection comes
            back by itself. No call waits longer than the time-out, and one that follows a late answer does not wait;
            to a bus on another machine none does, and whether it took a write is known with a later one.
        """
        is_taken = True
        for line, part in self.lines(values):
            with line._lock:
                is_taken &= line._post(line._writes.encode(part, capture_ns), [len(part)])
        return is_taken

    def publish_in_turn(self, writes: Sequence[tuple[Mapping[str, bytes], int | None]]) -> bool:
        """Write several times in one go, for a device whose samples come in batches, all over this bus.

        Args:
            writes: Bytes by key, and the device's own time of capture [ns], of each.

        Returns:
            Whether all are on their way.
        """
        with self._lock:
            requests = [self._writes.encode(values, capture_ns) for values, capture_ns in writes]
            return not requests or self._post(b"".join(requests), [len(values) for values, _ in writes])

    def catch_up(self) -> bool:
        """Read the answers that have come, without waiting; return whether none is owed any more.

        For a writer that would rather drop a value than have it wait in line behind earlier ones.
        """
        with self._lock:
            if self._connection is None:
                return False
            try:
                self._account(self._connection, self._connection.collect(0.0))
            except ConnectionLost as error:
                self._lose(error)
                return False
            return not self._connection.owed

    def get(self, key: str) -> bytes | None:
        """Return the value of a key, or None; says nothing of its age."""
        line = self.open_bulk() if keys.is_bulk(key) else self
        value: bytes | None = line.call("GET", key)
        return value

    def read(self, wanted: Sequence[str]) -> dict[str, Sample]:
        """Return what keys hold now, in one round trip; absent keys are left out and every age is unknown.

        A stamp may be older than its value: a stock script that overwrites a key leaves the stamp as it was.
        """
        if not wanted:
            return {}
        if (there := [key for key in wanted if keys.is_bulk(key)]) and self.bulk_address is not None:
            return self.read([key for key in wanted if not keys.is_bulk(key)]) | self.open_bulk().read(there)
        values = self.call("MGET", *wanted, *(keys.stamp(key) for key in wanted))
        pairs = zip(wanted, values[: len(wanted)], values[len(wanted) :], strict=True)
        return {
            key: Sample(key, value, stamp.decode(mark) if mark else None, None)
            for key, value, mark in pairs
            if value is not None
        }

    def stamps(self, names: Sequence[str]) -> dict[str, Stamp | None]:
        """Return the stamp beside each key, None for a foreign writer; of the values, pictures too, nothing is read."""
        if (there := [key for key in names if keys.is_bulk(key)]) and self.bulk_address is not None:
            return self.stamps([key for key in names if not keys.is_bulk(key)]) | self.open_bulk().stamps(there)
        if not names:
            return {}
        marks = self.call("MGET", *(keys.stamp(key) for key in names))
        return {key: stamp.decode(mark) if mark else None for key, mark in zip(names, marks, strict=True)}

    def names(self, pattern: str = "*") -> list[str]:
        """Return the keys that match a pattern, sorted, stamps left out; of a bulk bus that is lost, none."""
        found: set[str] = set()
        if not keys.is_bookkeeping(pattern) and self.bulk_address is not None:
            with contextlib.suppress(BusError):
                found.update(self.open_bulk().names(pattern))
        cursor = b"0"
        while True:
            cursor, page = self.call("SCAN", cursor, "MATCH", pattern, "COUNT", 1000)
            found.update(key.decode("utf-8", "surrogateescape") for key in page)
            if cursor == b"0":
                return sorted(key for key in found if not keys.is_stamp(key))

    def watch(self, wanted: Sequence[str], *, on_change: OnChange | None = None) -> Watch:
        """Return a watch that keeps the newest value of each key at hand; close it after use. See `Watch`."""
        told: dict[str, Any] = {"outages": self.outages, "clocks": self.clocks, "on_change": on_change}
        if not any(map(keys.is_bulk, wanted)) or self.bulk_address is None:
            return Watch(self.address, wanted, **told)
        return WatchOfBoth(self.address, wanted, bulk=self.bulk_address, **told)

    def call(self, *arguments: Argument) -> Any:
        """Send any request and return its answer.

        Raises:
            BusError: the bus is lost, or answered with an error.
        """
        with self._lock:
            if self._connection is None:
                raise BusError(f"bus {self.address}: lost; reconnecting ({self.last_error})")
            try:
                if self._connection.owed:
                    self._account(self._connection, self._connection.collect(self._timeout_s))
                if self._connection.owed:
                    raise BusError(f"bus {self.address}: no answer in time")
                return self._connection.call(*arguments)
            except ConnectionLost as error:
                self._lose(error)
                raise

    def close(self) -> None:
        """Close the connection and stop reconnecting; what was written last is on its way for a while at most."""
        self._closed.set()
        if self._bulk is not None:
            self._bulk.close()
        if not self._is_bulk:
            self.clocks.close()
        with self._lock:
            if self._connection is not None:
                if self._is_far:
                    with contextlib.suppress(ConnectionLost):
                        self._connection.collect(self._timeout_s)  # a line that is closed may drop what it carries
                self._connection.close()
                self._connection = None

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _patience_s(self, timeout_s: float) -> float:
        return max(timeout_s, _FAR_TIMEOUT_S) if self._is_far else timeout_s

    def _post(self, requests: bytes, counts: Sequence[int]) -> bool:
        """Send encoded writes of so many keys each; called with the lock held."""
        if self._connection is None:
            self._lost_writes += sum(counts)
            return False
        self._unanswered.extend(counts)
        if not self._connection.owed:
            self._heard_s = self.clock.monotonic_s()  # a long silence of ours is none of the server's
        try:
            wait_s = 0.0 if self._is_far else self._timeout_s  # a far answer takes longer than a period
            answers = self._connection.post(requests, len(counts), wait_s=wait_s)
            return not self._account(self._connection, answers)
        except ConnectionLost as error:
            self._lose(error)
            return False

    def _account(self, connection: Connection, answers: list[Any]) -> bool:
        """Record the answers to writes; return whether one was refused.

        Raises:
            ConnectionLost: answers are owed, and none has come for too long.
        """
        refusals = [answer for answer in answers if isinstance(answer, hiredis.ReplyError)]
        for answer in answers:
            count = self._unanswered.popleft()
            if isinstance(answer, hiredis.ReplyError):
                self._lost_writes += count
                self._refuse(count, answer)
            elif self._refused:
                self._end_refusals()
        now_s = self.clock.monotonic_s()
        if answers or not connection.owed:
            # One that was looked for in vain: while this process was paused, it did not look.
            if now_s - self._heard_s > _SILENT_S and self._looks_in_vain:
                self._record("bus-silent", _ns(self._heard_s))
            self._heard_s, self._looks_in_vain = now_s, 0
        elif now_s - self._heard_s > _STALL_S:
            connection.close()
            raise ConnectionLost(f"bus {self.address}: no answer for {_STALL_S:g} s")
        elif now_s - self._heard_s > _VAIN_S:
            self._looks_in_vain += 1
        return bool(refusals)

    def _refuse(self, count: int, answer: hiredis.ReplyError) -> None:
        """Record writes that the server does not take: it is full, loading, or not for us to write."""
        if not self._refused:
            self._refused_s = self.clock.monotonic_s()
        self._refused += count
        self._complain(f"bus {self.address} refuses writes: {answer}")

    def _end_refusals(self) -> None:
        log.info("bus %s: takes writes again; %d were refused", self.address, self._refused)
        self._record("bus-refused", _ns(self._refused_s), refused=self._refused, reason=self._bare(self.last_error))
        self._refused, self.last_error = 0, ""

    def _lose(self, error: BusError) -> None:
        """Record a lost connection, and reconnect in the background; called with the lock held."""
        began_s = self._heard_s if self._unanswered else self.clock.monotonic_s()
        lost = sum(self._unanswered)  # the server may have taken some: counted as lost, to be honest
        before = self._lost_writes
        self._connection = None
        self._lost_writes += lost
        self._unanswered.clear()
        self._complain(str(error))
        if not self._closed.is_set():
            began_ns, reason = _ns(began_s), self._bare(str(error))
            self.clock.start(lambda: self._reconnect(began_ns, before, reason), "bus-reconnect")

    def _reconnect(self, began_ns: int, lost_before: int, reason: str) -> None:
        """Connect again: at once, where only the connection was cut, or as soon as there is a server."""
        while not self._closed.is_set():
            try:
                fresh = Connection(self.address, timeout_s=self._timeout_s)
            except BusError as error:
                self._complain(str(error))
                self.clock.wait(self._closed, _RETRY_S)
                continue
            with self._lock:
                if self._closed.is_set():
                    fresh.close()
                    return
                self._connection, self.last_error, self._heard_s = fresh, "", self.clock.monotonic_s()
                self.connections += 1
                lost = self._lost_writes - lost_before
                self._record("bus-back", began_ns, lost_writes=lost, reason=reason)
                log.info("bus %s: back; %d writes were lost", self.address, lost)
            return

    def _record(self, kind: Kind, began_ns: int, **numbers: Any) -> None:
        """Record an outage that ends now; one of a bulk bus says so."""
        self.outages.record(kind, began_ns, **numbers, **({"bus": "bulk"} if self._is_bulk else {}))

    def _bare(self, reason: str) -> str:
        """Return a reason without the address, which is the same for all readers."""
        return reason.removeprefix(f"bus {self.address}").lstrip(": ")

    def _complain(self, reason: str) -> None:
        if reason != self.last_error:
            self.last_error = reason
            log.warning("%s", reason)


def _ns(monotonic_s: float) -> int:
    return round(monotonic_s * 1e9)
