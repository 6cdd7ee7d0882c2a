"""How far a tap lags behind the server, and how far it may: what it has not read yet, the server keeps for it."""

from __future__ import annotations

import re

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.tap.base import connect
from station.errors import BusError

_LOOK_S = 0.02  # as often as somebody who waits asks; an answer takes the server 0.05 ms
_OFFSET = re.compile(rb"^master_repl_offset:(\d+)\r?$", re.MULTILINE)
_REPLICAS = (b"slave", b"replica")


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
