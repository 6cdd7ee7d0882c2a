"""A bus server in this process: the commands that the station uses, byte for byte as the real one answers them.

`tests/virtual/test_server.py` plays the same commands to the real server and to this one and compares all answers and
messages.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable
from typing import Any

import hiredis

from station.clock import Clock

_CLASSES = "g$lshzxetd"
_ORDER = _CLASSES + "KEmn"
_SETTING = b"notify-keyspace-events"
_SETTINGS = {b"port": b"0", b"tls-port": b"0", b"bind": b""}  # a unix socket alone
_SUBSCRIBER_COMMANDS = (b"SUBSCRIBE", b"UNSUBSCRIBE", b"PING")

Reply = bytes


class Server:
    """Keys by database, clients, and the events of keys.

    Args:
        clock: For keys that expire, and what it answers to `TIME`.
        call_at: Has something done at an instant of that clock.

    Attributes:
        refused: Commands that no client may use, for a server without notifications above all.
        journal: Every write in order: when [ns], the key, and what it holds from then on, None for nothing.
    """

    def __init__(self, clock: Clock, call_at: Callable[[int, Callable[[], None]], None]) -> None:
        self.clock, self._call_at = clock, call_at
        self._databases: dict[int, dict[bytes, bytes]] = {}
        self._expiry: dict[tuple[int, bytes], int] = {}
        self._flags = ""
        self.refused: set[bytes] = set()
        self.journal: list[tuple[int, bytes, bytes | None]] = []
        self.clients: list[Client] = []

    def forget_all(self) -> None:
        """Lose keys, settings and clients, as one that was killed and started again."""
        self._databases.clear()
        self._expiry.clear()
        self._flags = ""
        for client in list(self.clients):
            client.close()

    def keys(self, db: int) -> dict[bytes, bytes]:
        """Return the keys of a database."""
        return self._databases.setdefault(db, {})

    def touch(self, db: int, event: str, kind: str, key: bytes) -> None:
        """Tell whoever subscribed to a key's channel of an event."""
        if "K" in self._flags and kind in self._flags:
            channel = b"__keyspace@%d__:%s" % (db, key)
            for client in self.clients:
                if channel in client.channels:
                    client.out(_array([b"message", channel, event.encode()]))

    def change(self, db: int, key: bytes, value: bytes) -> None:
        """Change what a key holds; it expires as before."""
        self.keys(db)[key] = value
        self.journal.append((self.clock.monotonic_ns(), key, value))

    def put(self, db: int, key: bytes, value: bytes) -> None:
        """Set a key; it does not expire."""
        self.change(db, key, value)
        self._expiry.pop((db, key), None)

    def remove(self, db: int, key: bytes) -> bytes | None:
        """Delete a key; return what it held."""
        self._expiry.pop((db, key), None)
        self.journal.append((self.clock.monotonic_ns(), key, None))
        return self.keys(db).pop(key, None)

    def expire(self, db: int, key: bytes, milliseconds: int) -> None:
        """Have a key go after a time."""
        due_ns = self._expiry[db, key] = self.clock.monotonic_ns() + milliseconds * 1_000_000

        def go() -> None:
            if self._expiry.get((db, key)) == due_ns:
                self.remove(db, key)
                self.touch(db, "expired", "x", key)

        self._call_at(due_ns, go)

    def copy_expiry(self, db: int, source: bytes, target: bytes) -> None:
        """Let one key expire when another one does."""
        due_ns = self._expiry.get((db, source))
        if due_ns is not None:
            self.expire(db, target, max(0, (due_ns - self.clock.monotonic_ns()) // 1_000_000))

    def move_expiry(self, db: int, source: bytes, target: bytes) -> None:
        """Let one key expire when another one would have."""
        self.copy_expiry(db, source, target)
        self._expiry.pop((db, source), None)

    @property
    def flags(self) -> bytes:
        """The setting of keyspace events, as the server spells it."""
        rest = self._flags
        if all(letter in rest for letter in _CLASSES):
            rest = "A" + "".join(letter for letter in rest if letter not in _CLASSES)
        return rest.encode()

    def set_flags(self, text: str) -> bool:
        """Take over the setting; return whether it is one."""
        if any(letter not in _ORDER + "A" for letter in text):
            return False
        found = set(text.replace("A", _CLASSES))
        self._flags = "".join(letter for letter in _ORDER if letter in found)
        return True

    def flush(self, db: int | None) -> None:
        """Lose the keys of a database, or all."""
        for number in list(self._databases) if db is None else [db]:
            for key in list(self.keys(number)):
                self.remove(number, key)


class Client:
    """A client of a server, as the server has it.

    Args:
        server: The server.
        out: Takes the bytes of answers and messages.
        on_close: Called when the server hangs up.
    """

    def __init__(self, server: Server, out: Callable[[bytes], None], on_close: Callable[[], None]) -> None:
        self.server, self.out, self._on_close = server, out, on_close
        self.channels: dict[bytes, None] = {}
        self._reader = hiredis.Reader()
        self._queued: list[list[bytes]] | None = None
        self._is_aborted = False
        self.db = 0
        server.clients.append(self)

    def feed(self, data: bytes) -> None:
        """Take bytes of requests, and do those that are whole."""
        self._reader.feed(data)
        while (request := self._reader.gets()) is not False:
            self.out(self._answer(request))

    def close(self) -> None:
        """Hang up."""
        if self in self.server.clients:
            self.server.clients.remove(self)
            self._on_close()

    def _answer(self, request: list[bytes]) -> Reply:
        name = request[0].upper()
        if name in self.server.refused:
            return _error(f"NOPERM User default has no permissions to run the '{_said(request)}' command")
        if self.channels and name not in _SUBSCRIBER_COMMANDS:
            return _error(
                f"ERR Can't execute '{_said(request)}': only (P|S)SUBSCRIBE / (P|S)UNSUBSCRIBE / PING / QUIT / RESET "
                "are allowed in this context"
            )
        if self._queued is not None and name == b"MULTI":
            self._is_aborted = True
            return _error("ERR Command not allowed inside a transaction")
        if self._queued is not None and name not in (b"EXEC", b"DISCARD"):
            self._queued.append(request)
            return b"+QUEUED\r\n"
        return _COMMANDS[name](self, request[1:])


def _said(request: list[bytes]) -> str:
    name = request[0].decode().lower()
    return f"{name}|{request[1].decode().lower()}" if name == "config" else name


# ---- answers ----


def _bulk(value: bytes | None) -> Reply:
    return b"$-1\r\n" if value is None else b"$%d\r\n%s\r\n" % (len(value), value)


def _integer(value: int) -> Reply:
    return b":%d\r\n" % value


def _array(values: list[Any]) -> Reply:
    parts = (
        _integer(value) if isinstance(value, int) else _array(value) if isinstance(value, list) else _bulk(value)
        for value in values
    )
    return b"*%d\r\n" % len(values) + b"".join(parts)


def _error(text: str) -> Reply:
    return f"-{text}\r\n".encode()


_OK = b"+OK\r\n"

# ---- commands ----


def _ping(client: Client, arguments: list[bytes]) -> Reply:
    if client.channels:
        return _array([b"pong", arguments[0] if arguments else b""])
    return _bulk(arguments[0]) if arguments else b"+PONG\r\n"


def _time(client: Client, arguments: list[bytes]) -> Reply:
    seconds, microseconds = divmod(client.server.clock.wall_ns() // 1000, 1_000_000)
    return _array([b"%d" % seconds, b"%d" % microseconds])


def _select(client: Client, arguments: list[bytes]) -> Reply:
    client.db = int(arguments[0])
    return _OK


def _set(client: Client, arguments: list[bytes]) -> Reply:
    key, value, *options = arguments
    words = [option.upper() for option in options]
    is_there = key in client.server.keys(client.db)
    if (b"NX" in words and is_there) or (b"XX" in words and not is_there):
        return _bulk(None)
    client.server.put(client.db, key, value)
    client.server.touch(client.db, "set", "$", key)
    if b"PX" in words:
        client.server.expire(client.db, key, int(options[words.index(b"PX") + 1]))
        client.server.touch(client.db, "expire", "g", key)
    return _OK


def _mset(client: Client, arguments: list[bytes]) -> Reply:
    for key, value in zip(arguments[::2], arguments[1::2], strict=True):
        client.server.put(client.db, key, value)
        client.server.touch(client.db, "set", "$", key)
    return _OK


def _get(client: Client, arguments: list[bytes]) -> Reply:
    return _bulk(client.server.keys(client.db).get(arguments[0]))


def _mget(client: Client, arguments: list[bytes]) -> Reply:
    return _array([client.server.keys(client.db).get(key) for key in arguments])


def _del(client: Client, arguments: list[bytes]) -> Reply:
    count = 0
    for key in arguments:
        if client.server.remove(client.db, key) is not None:
            client.server.touch(client.db, "del", "g", key)
            count += 1
    return _integer(count)


def _getdel(client: Client, arguments: list[bytes]) -> Reply:
    value = client.server.remove(client.db, arguments[0])
    if value is not None:
        client.server.touch(client.db, "del", "g", arguments[0])
    return _bulk(value)


def _rename(client: Client, arguments: list[bytes]) -> Reply:
    source, target = arguments
    if source not in client.server.keys(client.db):
        return _error("ERR no such key")
    if source == target:
        return _OK
    client.server.put(client.db, target, client.server.keys(client.db)[source])
    client.server.move_expiry(client.db, source, target)
    client.server.remove(client.db, source)
    client.server.touch(client.db, "rename_from", "g", source)
    client.server.touch(client.db, "rename_to", "g", target)
    return _OK


def _append(client: Client, arguments: list[bytes]) -> Reply:
    key, piece = arguments
    return _grow(client, key, client.server.keys(client.db).get(key, b"") + piece, "append")


def _setrange(client: Client, arguments: list[bytes]) -> Reply:
    key, offset, piece = arguments[0], int(arguments[1]), arguments[2]
    value = client.server.keys(client.db).get(key, b"")
    if not piece:
        return _integer(len(value))
    value = value.ljust(offset, b"\0")
    return _grow(client, key, value[:offset] + piece + value[offset + len(piece) :], "setrange")


def _grow(client: Client, key: bytes, value: bytes, event: str) -> Reply:
    client.server.change(client.db, key, value)
    client.server.touch(client.db, event, "$", key)
    return _integer(len(value))


def _copy(client: Client, arguments: list[bytes]) -> Reply:
    source, target, *options = arguments
    held = client.server.keys(client.db)
    if source == target:
        return _error("ERR source and destination objects are the same")
    if source not in held or (target in held and b"REPLACE" not in options):
        return _integer(0)
    client.server.put(client.db, target, held[source])
    client.server.copy_expiry(client.db, source, target)
    client.server.touch(client.db, "copy_to", "g", target)
    return _integer(1)


def _move(client: Client, arguments: list[bytes]) -> Reply:
    key, db = arguments[0], int(arguments[1])
    if db == client.db:
        return _error("ERR source and destination objects are the same")
    if key not in client.server.keys(client.db) or key in client.server.keys(db):
        return _integer(0)
    client.server.put(db, key, client.server.keys(client.db)[key])
    client.server.remove(client.db, key)
    client.server.touch(client.db, "move_from", "g", key)
    client.server.touch(db, "move_to", "g", key)
    return _integer(1)


def _pexpire(client: Client, arguments: list[bytes]) -> Reply:
    if arguments[0] not in client.server.keys(client.db):
        return _integer(0)
    client.server.expire(client.db, arguments[0], int(arguments[1]))
    client.server.touch(client.db, "expire", "g", arguments[0])
    return _integer(1)


def _flushall(client: Client, arguments: list[bytes]) -> Reply:
    client.server.flush(None)
    return _OK


def _flushdb(client: Client, arguments: list[bytes]) -> Reply:
    client.server.flush(client.db)
    return _OK


def _config(client: Client, arguments: list[bytes]) -> Reply:
    is_ours = arguments[1] == _SETTING
    if arguments[0].upper() == b"GET":
        value = client.server.flags if is_ours else _SETTINGS.get(arguments[1])
        return _array([] if value is None else [arguments[1], value])
    if client.server.set_flags(arguments[2].decode()):
        return _OK
    return _error(
        f"ERR CONFIG SET failed (possibly related to argument '{arguments[1].decode()}') - "
        "Invalid event class character. Use 'Ag$lshzxeKEtmdn'."
    )


def _subscribe(client: Client, arguments: list[bytes]) -> Reply:
    answers = b""
    for channel in arguments:
        client.channels[channel] = None
        answers += _array([b"subscribe", channel, len(client.channels)])
    return answers


def _scan(client: Client, arguments: list[bytes]) -> Reply:
    words = [word.upper() for word in arguments]
    pattern = arguments[words.index(b"MATCH") + 1].decode() if b"MATCH" in words else "*"
    found = [key for key in client.server.keys(client.db) if fnmatch.fnmatchcase(key.decode(), pattern)]
    return _array([b"0", found])


def _multi(client: Client, arguments: list[bytes]) -> Reply:
    client._queued, client._is_aborted = [], False
    return _OK


def _discard(client: Client, arguments: list[bytes]) -> Reply:
    if client._queued is None:
        return _error("ERR DISCARD without MULTI")
    client._queued = None
    return _OK


def _exec(client: Client, arguments: list[bytes]) -> Reply:
    if client._queued is None:
        return _error("ERR EXEC without MULTI")
    queued, client._queued = client._queued, None
    if client._is_aborted:
        return _error("EXECABORT Transaction discarded because of previous errors.")
    return b"*%d\r\n" % len(queued) + b"".join(client._answer(request) for request in queued)


_COMMANDS: dict[bytes, Callable[[Client, list[bytes]], Reply]] = {
    b"PING": _ping, b"SELECT": _select, b"SET": _set, b"MSET": _mset, b"GET": _get, b"MGET": _mget, b"DEL": _del,
    b"GETDEL": _getdel, b"RENAME": _rename, b"PEXPIRE": _pexpire, b"FLUSHALL": _flushall, b"FLUSHDB": _flushdb,
    b"CONFIG": _config, b"SUBSCRIBE": _subscribe, b"SCAN": _scan, b"MULTI": _multi, b"DISCARD": _discard,
    b"EXEC": _exec, b"TIME": _time, b"UNLINK": _del, b"APPEND": _append, b"SETRANGE": _setrange, b"COPY": _copy,
    b"MOVE": _move,
}  # fmt: skip
"""A command that is not in here ends the test that uses it."""
