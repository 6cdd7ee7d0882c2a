"""The newest command on the bus for a control step: that of the writer that is obeyed."""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.clocks import Clocks
from station.bus.connection import Connection
from station.bus.hearing import HeardSpan
from station.bus.outage import Outages
from station.bus.sample import Sample
from station.bus.watch import Read, Watch
from station.control.command_arbiter import CommandArbiter
from station.control.command_validator import CommandSample
from station.control.stop_trace import StopNews, StopTrace
from station.life import estop
from station.life.writer_conflict import FOREIGN

_PROBE_S = 0.05  # a silence is proven this much later at most; a probe takes 0.1 ms
_MOST = 16  # writers between two polls; any client may invent names
_AHEAD = 2  # writes that were read before they were told of, at most: each is told of within a round trip
_CONTEST_NS = 1_000_000_000  # so long after a foreign write the next may come
_MOST_WRITES = 4096  # between two polls: eight seconds of two writers at 250 Hz; more are forgotten


class Arrival(NamedTuple):
    """A write of the command key.

    Attributes:
        writer: Its source.
        at_ns: When it came, on the monotonic clock [ns].
        is_clear: Whether the value that was read is this writer's; otherwise only that the writer is alive is known.
    """

    writer: str
    at_ns: int
    is_clear: bool


class NewWrites(NamedTuple):
    """What came since the last poll.

    Attributes:
        heard: Span in which every write was heard; all that was written until its end is in here, or was before.
        arrivals: Writes in order.
        newest: The newest value of each writer, where it is known which value is whose.
    """

    heard: HeardSpan
    arrivals: list[Arrival]
    newest: dict[str, Sample]


class CommandWatch(Watch):
    """A watch that keeps the writers of one key apart: when each wrote, and its newest value (a slot holds the last
    value only). A stop it keeps until it is taken, whatever is written after it (`station.control.stop_trace`).

    A foreign write between a native one and our reading of it shows the foreign value beside the native stamp. So once
    a value is read, notifications are read again. A value that either kind of writer may have written is left out; both
    writers count as alive, and the next value will tell.

    Args:
        address: Where the bus is.
        wanted: Keys to watch.
        key: The one of them whose writers are told apart.
        outages, clocks: As of any watch.

    Attributes:
        urgent: Set when a write asks for the emergency stop: a loop that sleeps acts at once, and clears it.
        doubtful: Values of `key` that may be of either kind of writer, and were left out.
    """

    def __init__(
        self,
        address: BusAddress,
        wanted: Sequence[str],
        *,
        key: str,
        outages: Outages | None = None,
        clocks: Clocks | None = None,
    ) -> None:
        self._shared_key = key
        self._by_writer: dict[str, Sample] = {}
        self._arrivals: list[Arrival] = []
        self._numbers: dict[str, int] = {}  # sequence number of each native writer's newest write that was read
        self._ahead = 0
        self._is_doubtful = False
        self._foreign_ns = -_CONTEST_NS  # when a writer without stamps wrote the key last
        self._stops = StopTrace()
        self.urgent = threading.Event()
        self.doubtful = 0
        super().__init__(address, wanted, outages=outages, clocks=clocks, probe_s=_PROBE_S)

    def pop(self) -> NewWrites:
        """Return the writes since the last call; a loop that was paused finds those of the pause in them.

        Where they were too many to keep, the span of `heard` begins anew.
        """
        with self._changed:
            taken = NewWrites(self._hearing.span, self._arrivals, self._by_writer)
            self._arrivals, self._by_writer = [], {}
        return taken

    @property
    def has_stop_news(self) -> bool:
        """Whether a stop or its release was written since the last `pop_stop`."""
        return self._stops.has_news

    def pop_stop(self) -> StopNews | None:
        """Return what was asked on the key of the stop since the last call."""
        with self._changed:
            return self._stops.pop()

    def begin_stops(self) -> None:
        """Forget what was asked on the key of the stop until now; what it holds is in its slot."""
        with self._changed:
            self._stops.begin()

    def _on_message(self, message: Any, touched: Counter[str]) -> None:
        before = [touched[key] for key in estop.KEYS]
        super()._on_message(message, touched)
        for key, count in zip(estop.KEYS, before, strict=True):
            if touched[key] > count:
                self._stops.on_event(key, message[2])

    def _fill_at_start(self, reader: Connection) -> None:
        before, has_heard = [self._slots.get(key) for key in estop.KEYS], self.connections > 0
        super()._fill_at_start(reader)
        if has_heard:
            with self._changed:
                for key, known in zip(estop.KEYS, before, strict=True):
                    sample = self._slots.get(key)
                    self._stops.on_cut(key, sample.value if sample else None, is_new=sample is not known)
                self._hurry()

    def _read_touched(self, reader: Connection, touched: Counter[str]) -> None:
        while touched and not self._closed.is_set():
            wanted = [key for key in self._keys if key in touched or keys.stamp(key) in touched]
            values = self._fetch(reader, wanted)
            later = self._told_meanwhile()
            if self._events is not None and self._must_know_all(values):
                self._drain(self._events, later)
                unread = [key for key in estop.KEYS if later[key] and key not in values]
                values |= self._fetch(reader, unread)  # a press and its release at once are one story
            told = touched + later
            native, every = told[keys.stamp(self._shared_key)], told[self._shared_key]
            self._is_doubtful = 0 < native < every
            now_ns = self.clock.monotonic_ns()
            if native < every:
                self._foreign_ns = now_ns
            with self._changed:
                for key, (value, mark) in values.items():
                    self._put(key, value, mark, now_ns, is_foreign=touched[key] > touched[keys.stamp(key)])
                if self._shared_key in values and self._events is not None:  # a polled bus sends no notifications
                    self._record_overwritten(values[self._shared_key][1], touched[keys.stamp(self._shared_key)], now_ns)
                self._changed.notify_all()
            touched = later

    def _must_know_all(self, values: Mapping[str, Read]) -> bool:
        """Whether a value can be judged only once all notifications up to now have come.

        They come on another connection than the value, and over a network may come after it: beside a writer without
        stamps it is not known whose value it is before.
        """
        is_contested = self.clock.monotonic_ns() - self._foreign_ns < _CONTEST_NS
        return (self._shared_key in values and is_contested) or any(
            key in values and self._stops.may_have_missed(key, values[key][0]) for key in estop.KEYS
        )

    def _told_meanwhile(self) -> Counter[str]:
        """Count the notifications that have come by now, by key."""
        told: Counter[str] = Counter()
        events = self._events
        while events is not None and (message := events.poll()) is not False:
            self._on_message(message, told)
        return told

    def _put(self, key: str, value: bytes | None, mark: stamp.Stamp | None, now_ns: int, *, is_foreign: bool) -> None:
        before, mark_before = self._slots.get(key), self._newest_mark.get(key)
        super()._put(key, value, mark, now_ns, is_foreign=is_foreign)
        sample = self._slots.get(key)
        if key in estop.KEYS:
            is_new = before is None or (before.value, mark_before) != (value, mark)
            self._stops.on_read(key, value, is_new=is_new)
            self._hurry()
        if key != self._shared_key or sample is None or sample is before:
            return
        if self._is_doubtful:
            self.doubtful += 1
            if mark is not None and mark != mark_before:
                self._arrive(Arrival(mark.source, now_ns, is_clear=False))
            self._arrive(Arrival(FOREIGN, now_ns, is_clear=False))
            return
        writer = writer_of(sample)
        self._by_writer.pop(writer, None)
        if len(self._by_writer) < _MOST:
            self._by_writer[writer] = sample
            self._arrive(Arrival(writer, now_ns, is_clear=True))

    def _record_overwritten(self, mark: stamp.Stamp | None, told: int, now_ns: int) -> None:
        """Count writers as alive whose write may have been overwritten before it was read.

        The sequence numbers of the writer whose value was read say how many of the notified native writes are its own.
        Where they are fewer, another one wrote too: of two writers that answer to the same state, one is always
        overwritten at once.
        """
        own = 0
        if mark is not None:
            own = max(0, mark.seq - self._numbers.pop(mark.source, mark.seq - 1))
            self._numbers[mark.source] = mark.seq
            if len(self._numbers) > _MOST:
                del self._numbers[next(iter(self._numbers))]
        left = self._ahead + own - told
        self._ahead = min(max(left, 0), _AHEAD)
        if left < 0:
            for name in self._numbers:
                if mark is None or name != mark.source:
                    self._arrive(Arrival(name, now_ns, is_clear=False))

    def _hurry(self) -> None:
        if self._stops.is_stop_pending:
            self.urgent.set()

    def _arrive(self, arrival: Arrival) -> None:
        if len(self._arrivals) >= _MOST_WRITES:
            self._arrivals.clear()
            self._hearing.begin(arrival.at_ns)
        self._arrivals.append(arrival)


class CommandReceiver:
    """The newest command of a watch, as the control step wants it, and its writers.

    Args:
        watch: Watches the key.
        key: The command's key.
        writers: Decides which writer is obeyed.

    Attributes:
        heard_s: Span in which every write of it was heard, by the last call of `newest` or `has_come`, on the gate's
            clock [s].
    """

    def __init__(self, watch: CommandWatch, key: str, writers: CommandArbiter) -> None:
        self._watch, self._key, self.writers = watch, key, writers
        self.seen: Sample | None = None
        self._command: CommandSample | None = None
        self._refused = self._doubtful = 0
        self.heard_s = (-math.inf, -math.inf)

    def newest(self, now_s: float | None = None) -> CommandSample | None:
        """Return the newest command of the obeyed writer, the same object as long as nothing new came from it.

        Args:
            now_s: When a command that is new counts as arrived, on the gate's clock [s]; None for its real arrival
                on the monotonic clock.
        """
        self.has_come(now_s)
        return self._command

    def has_come(self, now_s: float | None = None) -> bool:
        """Receive what came since the last call; return whether the obeyed writer wrote."""
        before, newest, taken = self._command, self._watch.latest(self._key), self._watch.pop()
        self.heard_s = self._seconds(taken.heard, now_s)
        for writer, at_ns, is_clear in taken.arrivals:
            at_s = now_s if now_s is not None else at_ns * 1e-9
            if not is_clear:
                self.writers.alive(writer, at_s)
            elif not self.writers.on_write(writer, at_s, self.heard_s):
                self._refused += 1
        self.writers.know(self.heard_s)
        if self.writers.obeyed in taken.newest:
            self._command = _command(taken.newest[self.writers.obeyed], now_s)
        doubtful = self._watch.doubtful
        self._refused, self._doubtful = self._refused + doubtful - self._doubtful, doubtful
        if newest is not None and newest is not self.seen:
            is_left = newest.arrived_ns is None and self._command is before  # from before this watch began
            if is_left and self.writers.obeyed in ("", writer_of(newest)):
                self._command = _command(newest, now_s)
            self.seen = newest
        return self._command is not before

    def pop_refused(self) -> int:
        """Return how many commands of other, or of unknown, writers came since the last call."""
        refused, self._refused = self._refused, 0
        return refused

    def _seconds(self, heard: HeardSpan, now_s: float | None) -> tuple[float, float]:
        """Return a span on the gate's clock [s]."""
        ahead_s = 0.0 if now_s is None else now_s - self._watch.clock.monotonic_s()
        return heard.since_ns * 1e-9 + ahead_s, heard.until_ns * 1e-9 + ahead_s


def writer_of(sample: Sample) -> str:
    """Return the source of a value, or `FOREIGN`."""
    return sample.stamp.source if sample.stamp is not None else FOREIGN


def _command(sample: Sample, now_s: float | None) -> CommandSample:
    arrived_ns, mark = sample.arrived_ns, sample.stamp
    at_s = None if arrived_ns is None else arrived_ns * 1e-9 if now_s is None else now_s
    written_ns = sample.written_ns
    return CommandSample(
        value=sample.value,
        arrived_s=at_s,
        delay_s=sample.delay_s if now_s is None else None,  # ticks are no writer's clock
        written_ns=written_ns or 0,
        arrived_ns=arrived_ns or 0,
        seq=mark.seq if mark is not None else 0,
        source=writer_of(sample),
    )
