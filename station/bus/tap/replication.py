"""The lossless tap: a replica's view of the bus, in the server's own order, resumable by offset."""

from __future__ import annotations

import logging

from station.bus.address import BusAddress
from station.bus.connection import Connection, ConnectionLost
from station.bus.tap.base import Backend, Position, Write, connect, write_probe
from station.bus.tap.link import Link
from station.bus.tap.server_lag import ServerLag
from station.bus.tap.snapshot import taken
from station.bus.tap.stream import Stream
from station.errors import BusError

log = logging.getLogger(__name__)

_ARM_TIMEOUT_S = 20.0  # without any progress; measured 0.01 to 0.06 s
_DEFAULT_PING_PERIOD_S = 10
_SHORTEST_SILENCE_S = 5.0
_NEAR_BYTES = 1 << 20  # in 30 ms so much comes from three cameras, and a busy machine wakes a reader as late


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
            self._probe = self._write_probe()
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
        if self.is_catching_up and self._stream.probe == self._probe:
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
        while self._stream.probe != self._probe:
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
