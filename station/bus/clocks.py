"""Clocks of several machines on one bus: when a command from another machine was written, on this one's clock.

Each machine compares its monotonic clock with the time of the bus server (``TIME``, which any client may ask), and says
what it found on a key of its own. Two machines that say so know each other's clocks; neither has to answer the other.
The server's answer was given between question and answer, so every offset has an error that is a bound, as far as both
clocks run alike (`_DRIFT`).
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import math
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import msgspec

from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.clock import Clock, Thread
from station.errors import BusError

log = logging.getLogger(__name__)

KEPT = 64
"""Comparisons that count."""

MOST_ERROR_NS = 100_000_000
"""A clock that is not known better than to this is not known [ns]."""

_PERIOD_S, _FIRST_PERIOD_S = 0.1, 0.02  # between comparisons; the second until there are enough
_STATES_EVERY_S, _FIRST_STATES_EVERY_S = 1.0, 0.25
_TIMEOUT_S, _RETRY_S = 1.0, 1.0
_KEEPS_NS = 50_000_000  # how long an offset is not computed again, which takes 0.05 ms
_DRIFT = 1e-4  # how much faster one clock may run than another: two quartzes of 50 ppm each
_RESOLUTION_NS = 1_000  # of the server's answer
_MOST_MACHINES = 32  # any client may invent names


class Offset(NamedTuple):
    """What to add to an instant of one clock to have it on another [ns], and by how much that may be wrong [ns]."""

    ns: int
    error_ns: int


OffsetOf = Callable[[str], Offset | None]
"""Returns how the monotonic clock of a boot is to be read here; None where that is not known."""


def unknown(_boot: str) -> Offset | None:
    """Return None: nothing is known of other machines' clocks."""
    return None


class ClockStatement(msgspec.Struct, kw_only=True):
    """What a machine says of its clock on ``station:clock:<boot>``, every second.

    Attributes:
        boot: The machine, as in the stamps of its writers.
        host: Its name.
        mono_ns, wall_ns: An instant, on its monotonic and on its wall clock [ns].
        bus_ns: The same one by the bus server's wall clock [ns].
        error_ns: By how much `bus_ns` may be wrong [ns].
        since_bus_ns: From when on the bus server's clock has run without a leap, as far as this machine has seen [ns].
        round_trip_ns: Of the quickest comparison [ns].
        comparisons: How many counted.
        is_synchronised: Whether something (chrony, ntpd, PTP) keeps its wall clock right, by its kernel's word; None
            where the kernel does not say.
        wall_error_ns: By how much its wall clock may be wrong, by its kernel's word [ns]; None likewise.
    """

    boot: str
    host: str
    mono_ns: int
    wall_ns: int
    bus_ns: int
    error_ns: int
    since_bus_ns: int
    round_trip_ns: int
    comparisons: int
    is_synchronised: bool | None = None
    wall_error_ns: int | None = None

    @property
    def to_bus(self) -> int:
        """What to add to its monotonic clock to have the bus server's wall clock [ns]."""
        return self.bus_ns - self.mono_ns

    @property
    def wall_ahead_ns(self) -> int:
        """By how much its wall clock is ahead of the bus server's [ns]."""
        return self.wall_ns - self.bus_ns


class _Comparison(NamedTuple):
    mono_ns: int
    offset_ns: int  # from the monotonic clock to the bus's
    error_ns: int  # when it was made
    round_trip_ns: int

    def error_at(self, mono_ns: int) -> int:
        return self.error_ns + int(_DRIFT * abs(mono_ns - self.mono_ns))


class BusTime:
    """The bus server's clock from comparisons with the monotonic clock. Pure.

    Attributes:
        since_bus_ns: Of the first comparison since the last leap, by the bus's clock [ns].
    """

    def __init__(self) -> None:
        self._kept: deque[_Comparison] = deque(maxlen=KEPT)
        self.since_bus_ns = 0

    def add(self, asked_ns: int, bus_ns: int, answered_ns: int) -> bool:
        """Take an answer of the server; return whether its clock leapt, so that nothing of before counts.

        Args:
            asked_ns, answered_ns: When it was asked and the answer came, on the monotonic clock [ns].
            bus_ns: What it answered [ns].
        """
        middle_ns = (asked_ns + answered_ns) // 2
        round_trip_ns = answered_ns - asked_ns
        new = _Comparison(middle_ns, bus_ns - middle_ns, round_trip_ns // 2 + _RESOLUTION_NS, round_trip_ns)
        has_leapt = any(
            abs(new.offset_ns - old.offset_ns) > new.error_ns + old.error_at(middle_ns) for old in self._kept
        )
        if has_leapt:
            self._kept.clear()
        if not self._kept:
            self.since_bus_ns = bus_ns - new.error_ns
        self._kept.append(new)
        return has_leapt

    def __len__(self) -> int:
        return len(self._kept)

    def best(self, mono_ns: int) -> Offset | None:
        """Return the offset from the monotonic clock to the bus's at an instant; None before the first comparison.

        Each comparison says where the offset is at least and at most. What all of them leave is half as wide as the
        quickest way there and the quickest way back together, though none may have been quick both ways.
        """
        if not self._kept:
            return None
        bounds = [(each.offset_ns, each.error_at(mono_ns)) for each in self._kept]
        least, most = max(ns - error_ns for ns, error_ns in bounds), min(ns + error_ns for ns, error_ns in bounds)
        return Offset((least + most) // 2, (most - least + 1) // 2)

    @property
    def round_trip_ns(self) -> int:
        """The shortest one of the comparisons that count [ns]."""
        return min(each.round_trip_ns for each in self._kept)


def offset_of(theirs: ClockStatement, own: Offset, own_since_bus_ns: int, mono_ns: int) -> Offset | None:
    """Return how another machine's monotonic clock is to be read here, or None where its statement does not say.

    Args:
        theirs: What it said last.
        own: From this machine's monotonic clock to the bus's.
        own_since_bus_ns: As `BusTime.since_bus_ns`: what was said before a leap of the bus's clock says nothing.
        mono_ns: Now, on this machine's clock [ns].
    """
    age_ns = mono_ns + own.ns - theirs.bus_ns
    is_of_this_time = theirs.bus_ns + theirs.error_ns >= own_since_bus_ns and age_ns >= -MOST_ERROR_NS
    error_ns = own.error_ns + theirs.error_ns + int(_DRIFT * max(age_ns, 0))
    if not is_of_this_time or not 0 <= error_ns <= MOST_ERROR_NS:
        return None
    return Offset(theirs.to_bus - own.ns, error_ns)


class Clocks:
    """This machine's clock beside the bus server's, and what other machines say of theirs.

    It measures in a thread of its own, from `start` or from the first stamp of another machine on: where all processes
    run on one machine it does nothing. Thread safe.

    Args:
        address: Where the bus is.

    Attributes:
        publish: Writes to the bus what this machine's clock says; None for who only looks.
    """

    def __init__(self, address: BusAddress) -> None:
        self._address, self._clock = address, address.clock
        self.publish: Callable[[Mapping[str, bytes]], object] | None = None
        self._time, self._lock = BusTime(), threading.Lock()
        self._theirs: dict[str, ClockStatement | None] = {}
        self._found: dict[str, tuple[int, Offset | None]] = {}  # until when [ns] it need not be computed again
        self._closed = threading.Event()
        self._thread: Thread | None = None
        self._line: Connection | None = None

    def start(self) -> None:
        """Begin to measure and to say so; a second call does nothing."""
        with self._lock:
            if self._thread is None and not self._closed.is_set():
                self._thread = self._clock.start(self._run, "bus-clocks")

    def close(self) -> None:
        """End it."""
        self._closed.set()
        if (line := self._line) is not None:
            line.hang_up()
        if self._thread is not None:
            self._clock.join(self._thread, 2.0)

    def offset_of(self, boot: str) -> Offset | None:
        """Return how the monotonic clock of another boot is to be read here; None while that is not known."""
        if boot == stamp.boot_id():
            return None
        theirs = self._theirs.get(boot)
        if theirs is None:
            if boot and boot not in self._theirs and len(self._theirs) < _MOST_MACHINES:
                self._theirs[boot] = None  # from now on it is asked for
                self.start()
            return None
        until_ns, offset = self._found.get(boot, (0, None))
        if (now_ns := self._clock.monotonic_ns()) >= until_ns:
            offset = self._offset_of(theirs)
            self._found[boot] = now_ns + _KEEPS_NS, offset
        return offset

    def _offset_of(self, theirs: ClockStatement) -> Offset | None:
        now_ns = self._clock.monotonic_ns()
        with self._lock:
            best, since_bus_ns = self._time.best(now_ns), self._time.since_bus_ns
        return None if best is None else offset_of(theirs, best, since_bus_ns, now_ns)

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                with contextlib.closing(Connection(self._address, timeout_s=_TIMEOUT_S)) as line:
                    self._line = line
                    self._measure(line)
            except BusError as error:
                log.debug("clocks: %s", error)  # whoever reads or writes says so
                self._clock.wait(self._closed, _RETRY_S)

    def _measure(self, line: Connection) -> None:
        stated_s = -math.inf
        while not self._closed.is_set():
            asked_ns = self._clock.monotonic_ns()
            bus_ns = _instant(line.call("TIME"))
            answered_ns = self._clock.monotonic_ns()
            with self._lock:
                has_leapt = self._time.add(asked_ns, bus_ns, answered_ns)
            is_begun = len(self._time) >= KEPT
            now_s = self._clock.monotonic_s()
            if has_leapt or now_s - stated_s >= (_STATES_EVERY_S if is_begun else _FIRST_STATES_EVERY_S):
                stated_s = now_s
                self._state()
                self._ask(line)
            self._clock.wait(self._closed, _PERIOD_S if is_begun else _FIRST_PERIOD_S)

    def _state(self) -> None:
        if self.publish is None:
            return
        now_ns, wall_ns = self._clock.monotonic_ns(), self._clock.wall_ns()
        with self._lock:
            offset, since_bus_ns, count = self._time.best(now_ns), self._time.since_bus_ns, len(self._time)
            round_trip_ns = self._time.round_trip_ns
        assert offset is not None
        is_synchronised, wall_error_ns = kernel_says()
        statement = ClockStatement(
            boot=stamp.boot_id(), host=socket.gethostname(), mono_ns=now_ns, wall_ns=wall_ns,
            bus_ns=now_ns + offset.ns, error_ns=offset.error_ns, since_bus_ns=since_bus_ns,
            round_trip_ns=round_trip_ns, comparisons=count, is_synchronised=is_synchronised,
            wall_error_ns=wall_error_ns,
        )  # fmt: skip
        self.publish({keys.clock(statement.boot): codec.json_object(statement)})

    def _ask(self, line: Connection) -> None:
        wanted = list(self._theirs)
        for boot, data in zip(wanted, line.call("MGET", *map(keys.clock, wanted)) if wanted else [], strict=True):
            if (new := decode_statement(data, boot)) is not None:
                self._theirs[boot] = self._better(self._theirs[boot], new)

    def _better(self, known: ClockStatement | None, new: ClockStatement) -> ClockStatement:
        """Return which statement to go by: each process of a machine makes its own, a new one a worse one.

        Two that contradict each other are of a clock that stood still between them, as while a computer slept.
        """
        before, after = None if known is None else self._offset_of(known), self._offset_of(new)
        if known is None or before is None or after is None:
            return new
        agree = abs(before.ns - after.ns) <= before.error_ns + after.error_ns
        return known if agree and before.error_ns < after.error_ns else new


def walls_ahead_ns(call: Callable[..., Any], boots: Iterable[str], clock: Clock) -> dict[str, int]:
    """Return by how much the wall clocks of other machines are ahead of this one's [ns], by boot.

    A machine that says nothing of its clock counts as the bus server's: what runs beside that measures nothing.

    Args:
        call: Asks the bus something, as `station.bus.client.Bus.call`.
        boots: Of the machines, as in the stamps of their writers.
        clock: This machine's.

    Raises:
        BusError: the bus is lost, or refuses to tell its time.
    """
    wanted = list(boots)
    if not wanted:
        return {}
    asked_ns = clock.wall_ns()
    bus_ns = _instant(call("TIME"))
    bus_ahead_ns = bus_ns - (asked_ns + clock.wall_ns()) // 2
    found = dict.fromkeys(wanted, bus_ahead_ns)
    for boot, data in zip(wanted, call("MGET", *map(keys.clock, wanted)), strict=True):
        if (statement := decode_statement(data, boot)) is not None:
            found[boot] += statement.wall_ahead_ns
    return found


def decode_statement(data: bytes | None, boot: str) -> ClockStatement | None:
    """Return what a machine said of its clock, or None where bytes from the bus are no statement of that machine."""
    try:
        statement = None if data is None else codec.parse_struct(data, ClockStatement)
    except codec.BadValue as error:
        log.debug("not a clock's statement: %s", error)
        return None
    if statement is None or statement.boot != boot or statement.error_ns < 0:
        return None
    return statement


def _instant(reply: Any) -> int:
    """Return the server's wall clock [ns] from its answer to ``TIME``: seconds and microseconds."""
    try:
        seconds, microseconds = map(int, reply)
    except (TypeError, ValueError):
        raise BusError(f"the bus answered TIME with {reply!r}") from None
    return seconds * 1_000_000_000 + microseconds * 1_000


class _Timex(ctypes.Structure):
    """The head of ``struct timex`` (adjtimex(2)) of a 64-bit Linux; what follows is left alone."""

    _fields_ = (
        ("modes", ctypes.c_uint), ("offset", ctypes.c_long), ("freq", ctypes.c_long), ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long), ("status", ctypes.c_int), ("rest", ctypes.c_long * 32),
    )  # fmt: skip


_UNSYNCHRONISED = 0x40  # STA_UNSYNC


def kernel_says() -> tuple[bool | None, int | None]:
    """Return whether the wall clock is kept right by anything, and by how much it may be wrong [ns]; else None each."""
    found = _Timex()  # modes 0: to read, nothing is set
    try:
        if ctypes.CDLL(None).adjtimex(ctypes.byref(found)) < 0:
            return None, None
    except (AttributeError, OSError):  # no Linux
        return None, None
    is_synchronised = not found.status & _UNSYNCHRONISED
    return is_synchronised, found.maxerror * 1_000 if is_synchronised else None
