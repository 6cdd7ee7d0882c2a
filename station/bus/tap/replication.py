"""The lossless tap: a replica's view of the bus, in the server's own order, resumable by offset."""

from __future__ import annotations

import logging
import re
from itertools import islice

from station.bus.address import BusAddress
from station.bus.connection import Connection, ConnectionLost, pack
from station.bus.tap.base import (
    MOST_KEYS,
    PROBE,
    PROBE_LIFE_MS,
    Backend,
    Position,
    Snapshot,
    Write,
    connect,
    new_token,
    write_probe,
)
from station.bus.tap.link import Link
from station.bus.tap.stream import LARGEST_KNOWN, MOST_BYTES, Stream
from station.errors import BusError

log = logging.getLogger(__name__)

_ARM_TIMEOUT_S = 20.0  # without any progress; measured 0.01 to 0.06 s
_DEFAULT_PING_PERIOD_S = 10
_SHORTEST_SILENCE_S = 5.0
_NEAR_BYTES = 1 << 20  # in 30 ms so much comes from three cameras, and a busy machine wakes a reader as late

_LOOK_S = 0.02  # between two polls of a reader that waits; an answer takes the server 0.05 ms
_OFFSET = re.compile(rb"^master_repl_offset:(\d+)\r?$", re.MULTILINE)
_REPLICAS = (b"slave", b"replica")

_SCAN_COUNT = 1000


class ReplicationTap:
    """Every write, plain SETs of third parties included.

    One that goes on where another was lost finds what was written meanwhile at the server, which keeps it until it is
    read: nothing of it is gathered here.

    Args:
        address: The bus; only its database is tapped.
        resume: Go on behind this position if the server's backlog still holds what followed.

    Raises:
        TapRefused: the server does not let us be a replica.
        BusError: it cannot be reached, or the probe did not come back.

    A command that does not carry the whole value of its key (APPEND, COPY, RENAME …) arrives as the write of that value
    where what the key held before is known: from the stream, and from what all keys held when the tap was opened.

    Attributes:
        is_catching_up: Whether what `read` returns was written long before.
    """

    backend: Backend = "replication"
    is_lossless = True
    unseen_keys = 0

    def __init__(self, address: BusAddress, resume: Position | None = None) -> None:
        self._address, self._clock = address, address.clock
        self._link = Link(address, resume)
        self.resumed = self._link.is_resumed if resume is not None else None
        selected = resume.db if resume is not None and resume.db is not None and self.resumed else address.db
        self._stream = Stream(db=address.db, offset=self._link.offset, selected_db=selected, clock=address.clock)
        self._consumed = self._place()
        self._early: list[Write] = []  # came while we were arming
        self._lag: ServerLag | None = None
        self.is_catching_up = self.resumed is True
        try:
            self._stream.awaited = self._write_probe()
            if self.is_catching_up:  # that the server goes on tells that it sends us what is written
                self._lag = ServerLag(address)
            else:
                self._arm()
        except BaseException:
            self.close()
            raise

    def may_wait(self) -> bool:
        """Whether the server can keep what comes a little longer, also if we were killed now."""
        behind = self._behind()
        return self._lag is not None and behind is not None and behind <= self._lag.limit

    def read(self, timeout_s: float) -> list[Write]:
        """Return what arrived, in order; empty when nothing came in time."""
        if self._early:
            writes, self._early = self._early, []
        else:
            writes = self._read(timeout_s)
        self._consumed = self._place()
        if self.is_catching_up and self._stream.awaited is None:
            behind = self._behind()
            self.is_catching_up = behind is not None and behind > _NEAR_BYTES
        return writes

    def position(self) -> Position:
        """Return the place behind the last write that `read` returned."""
        return self._consumed

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self._link.close()
        if self._lag is not None:
            self._lag.close()

    def _read(self, timeout_s: float) -> list[Write]:
        deadline = self._clock.monotonic_s() + timeout_s
        while True:
            writes = self._receive(max(0.0, deadline - self._clock.monotonic_s()))
            if writes or self._clock.monotonic_s() >= deadline:
                return writes

    def _behind(self) -> int | None:
        return self._lag.behind(self._stream.offset) if self._lag is not None else None

    def _receive(self, timeout_s: float) -> list[Write]:
        data = self._link.receive(timeout_s)
        if not data:
            return []
        writes = self._stream.feed(data)
        self._link.offset = self._stream.offset
        if self._stream.wants_answer:
            self._stream.wants_answer = False
            self._link.acknowledge()
        return writes

    def _write_probe(self) -> bytes:
        connection = connect(self._address)
        try:
            self._stream.snapshot = taken(connection)
            token = self._stream.snapshot.probe if self._stream.snapshot else write_probe(connection)
            self._link.silence_limit_s = _silence_limit_s(connection)
        finally:
            connection.close()
        return token

    def _arm(self) -> None:
        """Wait until the probe has come back."""
        progress_at = self._clock.monotonic_s()
        while self._stream.awaited is not None:
            before = self._stream.offset
            self._early += self._receive(0.1)
            now = self._clock.monotonic_s()
            if self._stream.offset != before:
                progress_at = now
            elif now - progress_at > _ARM_TIMEOUT_S:
                raise BusError(
                    f"bus {self._address}: no write came back on the replication link for {_ARM_TIMEOUT_S:.0f} s"
                )

    def _place(self) -> Position:
        return Position(self._link.replication_id, self._stream.offset, self._stream.selected_db)


def _silence_limit_s(connection: Connection) -> float:
    """Return after how much silence the link is dead: three periods of the server's keep-alive."""
    try:
        period_s = int(connection.call("CONFIG", "GET", "repl-ping-replica-period")[1])
    except ConnectionLost:
        raise
    except (BusError, IndexError, ValueError):  # not allowed to ask, or a server that does not know the name
        period_s = _DEFAULT_PING_PERIOD_S
    return max(_SHORTEST_SILENCE_S, 3.0 * period_s + 2.0)


class ServerLag:
    """Measures on a line of its own, as the replication link carries no questions.

    A server cuts off a replica for which it would have to keep more than its output buffer takes; and if the recorder
    is killed now, the next one finds only what the backlog holds: what it had not read yet, what had not reached the
    disk, and what was written until it is there. So a tap may lag by half of the smaller of the two.

    Args:
        address: The bus.

    Attributes:
        limit: How far a tap may lag [bytes]; 0 where the server does not say how much it keeps.
    """

    def __init__(self, address: BusAddress) -> None:
        self._clock = address.clock
        self._connection: Connection | None = connect(address)
        self._size: int | None = None
        self._due_s = 0.0
        self.limit = min(self._kept(), default=0) // 2

    def behind(self, offset: int) -> int | None:
        """Return how many bytes of its history the server has beyond an offset; None where it does not say.

        It is asked fifty times a second at most; in between its last answer stands.
        """
        now_s = self._clock.monotonic_s()
        if now_s >= self._due_s:
            self._due_s, self._size = now_s + _LOOK_S, self._ask()
        return None if self._size is None else max(0, self._size - offset)

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _ask(self) -> int | None:
        if self._connection is None:
            return None
        try:
            found = _OFFSET.search(self._connection.call("INFO", "replication"))
        except BusError:  # may not ask, or the server is gone: the link meets that too, and says so
            self.close()
            return None
        return int(found[1]) if found else None

    def _kept(self) -> list[int]:
        """Return the server's bounds, those that it has [bytes]; none where it does not tell both."""
        try:
            backlog = int(self._setting("repl-backlog-size"))
            words = self._setting("client-output-buffer-limit").split()
            replica = next(index for index, word in enumerate(words) if word in _REPLICAS)
            bounds = [backlog, int(words[replica + 1]), int(words[replica + 2])]  # at once; for some seconds
        except (BusError, IndexError, ValueError, StopIteration):
            return []
        return [bound for bound in bounds if bound > 0]

    def _setting(self, name: str) -> bytes:
        if self._connection is None:
            raise BusError(f"no line to ask for {name}")
        value: bytes = self._connection.call("CONFIG", "GET", name)[1]
        return value


def taken(connection: Connection) -> Snapshot | None:
    """Write a probe, and read what there was at that instant.

    A key that is made between the listing and the transaction is not in it; the stream of a link that was open before
    tells of it.

    Returns:
        The snapshot; None where this user may not do all of it: nothing was written then.

    Raises:
        ConnectionLost: the server is gone.
    """
    try:
        names, is_whole = _names(connection)
        wanted, unread = _small(connection, names)
        connection.call("MULTI")
        token, values = _probe_and_read(connection, wanted)
    except ConnectionLost:
        raise
    except BusError as error:
        log.info("what keys hold is not known before they are written: %s", error)
        connection.send_packed(pack("DISCARD"))
        return None
    held = {key: value for key, value in zip(wanted, values, strict=True) if value is not None}
    return Snapshot(token, held, unread, is_whole)


def _probe_and_read(connection: Connection, wanted: list[bytes]) -> tuple[bytes, list[bytes | None]]:
    """Do what is done in the transaction that is open; return the probe's value, and those that were wanted."""
    token = new_token()
    requests: list[tuple[bytes | str | int, ...]] = [("SET", PROBE, token, "PX", PROBE_LIFE_MS)]
    if wanted:
        requests.append(("MGET", *wanted))
    *_, done = connection.pipeline([*requests, ("EXEC",)])
    return token, done[1] if wanted else []


def _names(connection: Connection) -> tuple[list[bytes], bool]:
    """Return the names of the keys, and whether these are all."""
    found: dict[bytes, None] = {}
    cursor = b"0"
    while True:
        cursor, page = connection.call("SCAN", cursor, "COUNT", _SCAN_COUNT)
        found.update(dict.fromkeys(page))
        if cursor == b"0" or len(found) > MOST_KEYS:
            return list(islice(found, MOST_KEYS)), cursor == b"0" and len(found) <= MOST_KEYS


def _small(connection: Connection, names: list[bytes]) -> tuple[list[bytes], tuple[bytes, ...]]:
    """Return the names of strings that are read, and of those that would take too much memory."""
    sizes = connection.send_packed(b"".join(pack("STRLEN", name) for name in names), len(names))
    wanted, unread, total = [], [], 0
    for name, size in zip(names, sizes, strict=True):
        if isinstance(size, int) and size <= LARGEST_KNOWN and total + size <= MOST_BYTES:
            wanted.append(name)
            total += size
        else:
            unread.append(name)
    return wanted, tuple(unread)
