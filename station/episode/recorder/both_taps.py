"""The taps of a bus and of its bulk bus as one: the writes of both in order, and one position that holds both places.

The bulk bus is read in a thread of its own. That it is cut, slow or gone never holds up what comes from the bus: a
robot is recorded on, and what is missing of depth and clouds is told as a hole.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import msgspec

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.clocks import OffsetOf, unknown
from station.bus.tap import Position, Tap, Write, open_tap, why_not_resumed
from station.bus.tap.base import Backend
from station.bus.tap.replication import ServerLag
from station.episode.recorder.resume import newest_written_ns, written_ns
from station.errors import BusError

log = logging.getLogger(__name__)

_READ_S = 0.02
_RETRY_S = 0.05
_MOST_BYTES = 64 << 20  # that wait to be taken; more waits at the server
_CLOSE_S = 3.0  # a server that is frozen holds up a new tap for as long
_LATE = "bulk bus: what was written over it had not come when a request to the recorder did"
_SETTLE_S = 0.25  # what a request waits for the bulk bus, which is milliseconds behind where it lives


class Cut(NamedTuple):
    """What befell the line to the bulk bus.

    Attributes:
        kind: ``lost``: it is gone, and tried again. ``resumed``: it goes on where it was. ``hole``: it goes on, and
            what was written in between is missing.
        from_ns, to_ns: From when to when [ns, monotonic]; the same while it is lost.
        reason: Why.
    """

    kind: Literal["lost", "resumed", "hole"]
    from_ns: int
    to_ns: int
    reason: str


def open_taps(
    bus: BusAddress, bulk: BusAddress | None, *, resume: Position | None, backend: str | None,
    since_ns: int, is_bulk_apart: bool = False, offset_of: OffsetOf = unknown,
) -> Tap:  # fmt: skip
    """Open the tap of a bus, and of its bulk bus where there is one.

    Args:
        bus, bulk: Where they are.
        resume: Go on behind this position.
        backend: As of `open_tap`.
        since_ns: Up to when writes are known [ns, monotonic], where the bulk bus has a hole.
        is_bulk_apart: Whether the bulk bus goes on where it was although the bus could not; not so for files of which
            more is kept than the position tells.
        offset_of: How the clocks of other machines are to be read.

    Raises:
        BusError: the bus cannot be reached, or tapped; the bulk bus is tried again until it can.
    """
    tap = open_tap(bus, resume=resume, backend=backend)
    if bulk is None:
        return tap
    goes_on = resume is not None and (tap.resumed or is_bulk_apart)
    return BothTaps(tap, bulk, resume.bulk if resume is not None and goes_on else None, backend=backend,
                    is_expected=bool(goes_on), since_ns=since_ns, offset_of=offset_of)  # fmt: skip


def cuts_of(tap: Tap) -> list[Cut]:
    """Return what befell the bulk bus of a tap since this was asked last."""
    return tap.cuts() if isinstance(tap, BothTaps) else []


class BothTaps:
    """A tap (`station.bus.tap.Tap`) of a bus and of its bulk bus.

    Writes of one bus stay in its order. Between the two the order is that of arrival; where a request to the recorder
    is among them, or where they waited at the servers for this tap, that of writing, so an episode has all that was
    written before its end.

    Args:
        tap: Of the bus; closed with this one.
        bulk: Where the bulk bus is.
        resume: Where its tap is to go on.
        backend: As of `open_tap`.
        is_expected: Whether it is a hole if it does not go on there.
        since_ns: Up to when its writes are known [ns, monotonic]: where that hole begins.
        offset_of: How the clocks of other machines are to be read.
    """

    def __init__(
        self, tap: Tap, bulk: BusAddress, resume: Position | None, *, backend: str | None, is_expected: bool,
        since_ns: int, offset_of: OffsetOf,
    ) -> None:  # fmt: skip
        self._tap, self._offset_of = tap, offset_of
        self.backend: Backend = tap.backend
        self.resumed = tap.resumed
        self._bulk = _BulkReader(bulk, resume, backend=backend, is_expected=is_expected, since_ns=since_ns)
        self._held: list[Write] = []  # of the bus, until the bulk bus is as far
        self._place = tap.position()
        self._last_ns = 0
        self.is_catching_up = True
        self._look()

    def cuts(self) -> list[Cut]:
        """Return what befell the bulk bus since this was asked last."""
        return self._bulk.cuts()

    def read(self, timeout_s: float) -> list[Write]:
        """Return what arrived of both; empty when nothing came in time."""
        if not self._held and not self.is_catching_up:
            writes = self._tap.read(timeout_s)
            if all(write.key != keys.RECORD for write in writes):
                return self._given(_as_arrived(writes, self._bulk.take()))
            self._bulk.wait_until_now(_SETTLE_S)
            return self._given(self._as_written(writes, self._bulk.take()))
        if not (held := self._held or self._tap.read(timeout_s)):
            return self._given(self._as_written([], self._bulk.take()))
        until_ns = newest_written_ns(held)
        is_there = self._bulk.wait_for(until_ns, timeout_s)
        self._held = [] if is_there else held
        bulk = self._bulk.take(until_ns if self._tap.is_catching_up else None)
        return self._given(self._as_written(held if is_there else [], bulk))

    def settle(self) -> list[Write]:
        """Return what is left of the bulk bus that was written by now."""
        self._bulk.wait_until_now(_SETTLE_S)
        held, self._held = self._held, []
        return self._given(self._as_written(held, self._bulk.take()))

    def may_wait(self) -> bool:
        """As of `Tap`; of both."""
        return self._tap.may_wait() and self._bulk.may_wait

    def position(self) -> Position | None:
        """Return the place of both behind the last write that `read` returned."""
        if self._place is None:
            return None
        return msgspec.structs.replace(self._place, bulk=self._bulk.taken)

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self._bulk.close()
        self._tap.close()

    def _given(self, writes: list[Write]) -> list[Write]:
        """Return writes, none of them before one that was returned earlier."""
        if not self._held:
            self._place = self._tap.position()
        for number, write in enumerate(writes):
            if write.mono_ns < self._last_ns:
                writes[number] = write._replace(mono_ns=self._last_ns)
            self._last_ns = writes[number].mono_ns
        self._look()
        return writes

    def _look(self) -> None:
        """Set what a tap says of itself, of both."""
        self.is_lossless = self._tap.is_lossless and self._bulk.is_lossless
        # What the bulk bus alone was late with comes when it comes: the bus does not wait for it.
        self.is_catching_up = self.is_catching_up and (self._tap.is_catching_up or self._bulk.is_late)
        self.unseen_keys = self._tap.unseen_keys + self._bulk.unseen_keys

    def _as_written(self, writes: Sequence[Write], bulk: Sequence[Write]) -> list[Write]:
        timed = [*self._timed(writes), *self._timed(bulk)]
        return [write for _, write in sorted(timed, key=lambda each: each[0])]

    def _timed(self, writes: Sequence[Write]) -> Iterator[tuple[int, Write]]:
        """Yield writes with when each was written; one that does not tell came right behind the one before it."""
        at_ns = 0
        for write in writes:
            at_ns = max(at_ns, min(written_ns(write, self._offset_of) or 0, write.mono_ns))
            yield at_ns, write


def _as_arrived(writes: list[Write], bulk: list[Write]) -> list[Write]:
    if not bulk or not writes:
        return writes or bulk
    return sorted([*writes, *bulk], key=lambda write: write.mono_ns)


class _Batch(NamedTuple):
    writes: list[Write]
    position: Position | None
    size: int
    written_ns: int
    is_late: bool


class _BulkReader:
    """Reads the tap of a bulk bus in a thread, opens it again when it is lost, and keeps what came until it is taken.

    Attributes:
        taken: The place behind what was taken last.
        may_wait: Whether the server can keep what comes a little longer.
    """

    def __init__(
        self, address: BusAddress, resume: Position | None, *, backend: str | None, is_expected: bool, since_ns: int
    ) -> None:
        self._address, self._backend = address, backend
        self._clock = address.clock
        self.taken = resume
        self.is_lossless, self.may_wait, self.unseen_keys = True, True, 0
        self._is_tap_late = False
        self._read_to = resume
        self._known_ns = since_ns  # up to when we know of every write
        self._is_expected = is_expected
        self._reason = ""  # why it is lost; "" while it is not
        self._batches: deque[_Batch] = deque()
        self._size = 0
        self._cuts: list[Cut] = []
        self._changed = threading.Condition()
        self._closed = threading.Event()
        self._tap: Tap | None = None
        self._open()
        self._thread = self._clock.start(self._run, "bulk-tap")

    @property
    def is_late(self) -> bool:
        """Whether what waits, or comes next, was written long before."""
        with self._changed:
            return self._is_tap_late or any(batch.is_late for batch in self._batches)

    def take(self, until_ns: int | None = None) -> list[Write]:
        """Return what came, in order; where an instant is given [ns, monotonic], only what was written by then."""
        found: list[Write] = []
        with self._changed:
            while self._batches and (until_ns is None or self._batches[0].written_ns <= until_ns):
                batch = self._batches.popleft()
                self._size -= batch.size
                self.taken = batch.position
                found += batch.writes
            self._changed.notify_all()
        return found

    def cuts(self) -> list[Cut]:
        """Return what befell the line since this was asked last."""
        with self._changed:
            found, self._cuts = self._cuts, []
        return found

    def wait_for(self, instant_ns: int, timeout_s: float) -> bool:
        """Wait until all is here, or lost, that was written before an instant [ns, monotonic]; return whether it is."""
        with self._changed:
            self._clock.wait_for(self._changed, lambda: self._is_at(instant_ns) or self._is_full, timeout_s)
            return self._is_at(instant_ns)

    def wait_until_now(self, timeout_s: float) -> None:
        """Wait until all is here that was written by now, or is lost; what does not come in time is a hole."""
        position = self._read_to
        if self._reason or position is None:
            return
        end = self._end(position.offset)
        with self._changed:
            is_there = end is not None and self._clock.wait_for(
                self._changed, lambda: self._is_behind(end) or self._is_full, timeout_s
            )
            if not is_there and not self._reason:
                self._cuts.append(Cut("hole", self._known_ns, self._clock.monotonic_ns(), _LATE))

    def _end(self, offset: int) -> int | None:
        """Return the offset at which the server's stream ends now; None where it does not answer."""
        try:
            lag = ServerLag(self._address)
        except BusError:
            return None
        behind = lag.behind(offset)
        lag.close()
        return None if behind is None else offset + behind

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self._closed.set()
        with self._changed:
            self._changed.notify_all()
        self._clock.join(self._thread, _CLOSE_S)

    @property
    def _is_full(self) -> bool:
        return self._size >= _MOST_BYTES or self._closed.is_set()

    def _is_at(self, instant_ns: int) -> bool:
        return bool(self._reason) or not self._is_tap_late or self._known_ns >= instant_ns

    def _is_behind(self, offset: int) -> bool:
        return bool(self._reason) or self._read_to is None or self._read_to.offset >= offset

    def _run(self) -> None:
        while not self._closed.is_set():
            if self._tap is None:
                self._clock.wait(self._closed, _RETRY_S)
                self._open()
                continue
            try:
                self._read(self._tap)
            except BusError as error:
                self._lose(error)
        if self._tap is not None:
            self._tap.close()

    def _read(self, tap: Tap) -> None:
        """Take what came, unless what waits here is to be taken first."""
        self.may_wait = tap.may_wait()
        with self._changed:
            if self._is_full and not self._clock.wait_for(self._changed, lambda: not self._is_full, _READ_S):
                return
        was_late, writes = tap.is_catching_up, tap.read(_READ_S)
        now_ns = self._clock.monotonic_ns()
        with self._changed:
            before, self._read_to = self._read_to, tap.position()
            self._is_tap_late, self.unseen_keys = tap.is_catching_up, tap.unseen_keys
            if self._is_tap_late:
                self._known_ns = max(self._known_ns, min(newest_written_ns(writes), now_ns))
            elif self._read_to is None or self._read_to != before:  # it pings; one that is frozen proves nothing
                self._known_ns = now_ns
            if writes:
                size = sum(len(write.value or b"") for write in writes)
                is_late, at_ns = self._is_tap_late or was_late, newest_written_ns(writes) or self._known_ns
                self._batches.append(_Batch(writes, self._read_to, size, at_ns, is_late))
                self._size += size
            elif not self._batches:
                self.taken = self._read_to
            self._changed.notify_all()

    def _open(self) -> None:
        try:
            tap = open_tap(self._address, resume=self._read_to, backend=self._backend)
        except BusError as error:
            self._lose(error)
            return
        now_ns = self._clock.monotonic_ns()
        with self._changed:
            self._tap, self.is_lossless, self._is_tap_late = tap, tap.is_lossless, tap.is_catching_up
            if not tap.resumed:
                if self._is_expected or self._reason:
                    why = f"bulk bus: {why_not_resumed(self._read_to, tap.position())}"
                    self._cuts.append(Cut("hole", self._known_ns, now_ns, why))
                self._read_to, self._known_ns = tap.position(), now_ns
                if not self._batches:
                    self.taken = self._read_to
            elif self._reason:
                self._cuts.append(Cut("resumed", self._known_ns, now_ns, self._reason))
            self._reason, self._is_expected = "", True
            self._changed.notify_all()

    def _lose(self, error: BusError) -> None:
        reason = "bulk bus: " + str(error).removeprefix(f"bus {self._address}: ").partition("; does a station run")[0]
        with self._changed:
            if self._tap is not None:
                self._tap.close()
            if not self._reason:
                self._cuts.append(Cut("lost", self._known_ns, self._known_ns, reason))
            self._tap, self._reason, self._is_tap_late, self.may_wait = None, reason, False, True
            self._changed.notify_all()
