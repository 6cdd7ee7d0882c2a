"""The lossless tap: a replica's view of the bus, in the server's own order, resumable by offset."""

from __future__ import annotations

import logging
import time
from collections import deque

from station.bus.address import BusAddress
from station.bus.connection import Connection, ConnectionLost
from station.bus.tap.base import Backend, Position, Write, connect, write_probe
from station.bus.tap.link import Link
from station.bus.tap.stream import Stream
from station.errors import BusError

log = logging.getLogger(__name__)

_ARM_TIMEOUT_S = 20.0  # without any progress; measured 0.01 to 0.06 s
_DEFAULT_PING_PERIOD_S = 10
_SHORTEST_SILENCE_S = 5.0


class ReplicationTap:
    """Every write, plain SETs of third parties included.

    Args:
        address: The bus; only its database is tapped.
        resume: Go on behind this position if the server's backlog still holds what followed.

    Raises:
        TapRefused: the server does not let us be a replica.
        BusError: it cannot be reached, or the probe did not come back.
    """

    backend: Backend = "replication"
    is_lossless = True

    def __init__(self, address: BusAddress, resume: Position | None = None) -> None:
        self._address = address
        self._link = Link(address, resume)
        self.resumed = self._link.is_resumed if resume is not None else None
        selected = resume.db if resume is not None and resume.db is not None and self.resumed else address.db
        self._stream = Stream(db=address.db, offset=self._link.offset, selected_db=selected)
        self._consumed = self._place()
        self._waiting: deque[tuple[list[Write], Position]] = deque()  # came while we were arming, each with its end
        try:
            self._arm()
        except BaseException:
            self._link.close()
            raise

    @property
    def not_mirrored(self) -> int:
        """Commands of others so far that changed a key without carrying its whole value (APPEND, INCR, HSET …)."""
        return self._stream.not_mirrored

    @property
    def is_catching_up(self) -> bool:
        """Whether the next `read` returns what had waited at the server before this tap was there."""
        return self.resumed is True and bool(self._waiting)

    def read(self, timeout_s: float) -> list[Write]:
        """Return what arrived, in order; empty when nothing came in time."""
        if self._waiting:
            writes, self._consumed = self._waiting.popleft()
            return writes
        deadline = time.monotonic() + timeout_s
        while True:
            writes = self._receive(max(0.0, deadline - time.monotonic()))
            if writes or time.monotonic() >= deadline:
                break
        self._consumed = self._place()
        return writes

    def position(self) -> Position:
        """Return the place behind the last write that `read` returned."""
        return self._consumed

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self._link.close()

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

    def _arm(self) -> None:
        connection = connect(self._address)
        try:
            token = write_probe(connection)
            self._link.silence_limit_s = _silence_limit_s(connection)
        finally:
            connection.close()
        progress_at = time.monotonic()
        while self._stream.probe != token:
            before = self._stream.offset
            if writes := self._receive(0.1):
                self._waiting.append((writes, self._place()))
            now = time.monotonic()
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
