"""One bus server for all tests of a run that are not about the server itself."""

from __future__ import annotations

import contextlib
from pathlib import Path

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.errors import BusError
from tests.warm.starts import LASTING

_ANSWERS_S = 10.0


class SharedBus:
    """A server that each test finds as if it had just been started.

    Args:
        folder: Of its socket.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._count = folder, 0
        self._server: RedisServer | None = None
        self._settings: dict[bytes, bytes] = {}
        self._users: list[bytes] = []

    def empty(self) -> BusAddress:
        """Return the address of a server without keys, clients and changed settings; a new one where needed."""
        if self._server is None or not self._is_as_new():
            self.close()
            self._count += 1
            folder = self._folder / str(self._count)  # the socket of a frozen server is not free
            folder.mkdir()
            self._server = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
            LASTING.add(self._server.pid)
            with contextlib.closing(Connection(self._server.address, timeout_s=_ANSWERS_S)) as line:
                self._settings, self._users = _settings(line), line.call("ACL", "LIST")
        return self._server.address

    def close(self) -> None:
        """Stop the server."""
        if self._server is not None:
            self._server.stop()
            self._server = None

    def _is_as_new(self) -> bool:
        """Clean the server; return False where it cannot be cleaned: dead, frozen, or another one in its place."""
        assert self._server is not None
        if not self._server.is_running:
            return False
        try:
            with contextlib.closing(Connection(self._server.address, timeout_s=_ANSWERS_S)) as line:
                if b"process_id:%d\r" % self._server.pid not in line.call("INFO", "server"):
                    return False
                for kind in ("normal", "pubsub", "replica"):
                    line.call("CLIENT", "KILL", "TYPE", kind, "SKIPME", "yes")
                for name, value in _settings(line).items():
                    if value != self._settings[name]:
                        line.call("CONFIG", "SET", name, self._settings[name])
                line.call("FLUSHALL")
                line.call("SCRIPT", "FLUSH")
                line.call("CONFIG", "RESETSTAT")
                return bool(line.call("ACL", "LIST") == self._users)
        except BusError:
            return False


def _settings(line: Connection) -> dict[bytes, bytes]:
    flat = line.call("CONFIG", "GET", "*")
    return dict(zip(flat[::2], flat[1::2], strict=True))
