"""From the bytes of a replication stream to writes, with exact account of the bytes.

The stream is a sequence of commands, each a RESP array of bulk strings. There is one canonical way to encode such
an array and the server uses it, so the length of a command on the wire follows from its parsed form. That is needed
because hiredis does not say how many bytes it has consumed, and a wrong count by one byte breaks every resumption.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import hiredis

from station.bus.tap.base import PROBE, Write, key_name
from station.errors import BusError

log = logging.getLogger(__name__)

Command = list[bytes]

_KNOWN_KEYS_LIMIT = 100_000
_MOST_REPORTS = 50
_LONGEST_KEY = 4096  # bytes; names are remembered, and the server takes some as long as values
# Commands that arrive on the link and change no value of a string key.
_SILENT = frozenset(
    b"PING MULTI EXEC EXPIRE EXPIREAT PEXPIRE PEXPIREAT PERSIST PUBLISH SPUBLISH SCRIPT FUNCTION".split()
)


def encoded_length(command: Command) -> int:
    """Return how many bytes a command takes in the stream: ``*N CRLF`` and ``$len CRLF data CRLF`` for each part."""
    total = 3 + len(str(len(command))) + 5 * len(command)
    for part in command:
        size = len(part)
        total += size + (1 if size < 10 else 2 if size < 100 else len(str(size)))
    return total


class Stream:
    """Reads commands and keeps the account.

    Args:
        db: Database whose writes are wanted.
        offset: Bytes of the server's history before the first byte that will be fed.
        selected_db: Database that the stream has selected there.

    Attributes:
        offset: Bytes of the server's history up to the end of the last whole command.
        selected_db: Database selected there.
        probe: Value of the last probe key that came by.
        wants_answer: Whether the server asked for an acknowledgement; whoever sends it resets this.
        not_mirrored: Commands that changed a key without carrying its whole value (APPEND, INCR, HSET …), or one with a
            name of kilobytes.
    """

    def __init__(self, *, db: int, offset: int, selected_db: int) -> None:
        self.offset = offset
        self.selected_db = selected_db
        self.probe: bytes | None = None
        self.wants_answer = False
        self.not_mirrored = 0
        self._db = db
        self._reader = hiredis.Reader()
        self._reader.setmaxbuf(1 << 20)  # keep the buffer between values of 60 KB instead of growing it each time
        self._fed = offset
        self._names: dict[bytes, str] = {}  # also tells which keys a FLUSHDB takes away
        self._reported: set[bytes] = set()
        self._writes: list[Write] = []
        self._now_ns = 0
        self._handlers = self._make_handlers()

    def feed(self, data: bytes | memoryview) -> list[Write]:
        """Take bytes off the wire and return the writes that they complete.

        Raises:
            BusError: the bytes are no commands.
        """
        if self._fed == self.offset and data[:1] == b"\n":
            data = bytes(data).lstrip(b"\n")  # keep-alive between two commands; the server does not count it either
        self._fed += len(data)
        self._now_ns = time.monotonic_ns()
        writes: list[Write] = []
        self._writes = writes
        handlers = self._handlers
        try:
            self._reader.feed(data)
            while (command := self._reader.gets()) is not False:
                name = command[0]
                (handlers.get(name) or handlers.get(name.upper()) or self._on_other)(command)
                self.offset += encoded_length(command)
        except (hiredis.ProtocolError, TypeError, AttributeError, IndexError, ValueError) as error:
            raise BusError(f"replication stream: not a command near offset {self.offset}: {error}") from error
        return writes

    def _make_handlers(self) -> dict[bytes, Callable[[Command], None]]:
        handlers: dict[bytes, Callable[[Command], None]] = dict.fromkeys(_SILENT, _ignore)
        handlers.update(dict.fromkeys((b"SET", b"SETNX", b"GETSET"), self._on_set))
        handlers.update(dict.fromkeys((b"SETEX", b"PSETEX"), self._on_setex))
        handlers.update(dict.fromkeys((b"MSET", b"MSETNX"), self._on_mset))
        handlers.update(dict.fromkeys((b"DEL", b"UNLINK", b"GETDEL"), self._on_delete))
        handlers.update({b"SELECT": self._on_select, b"REPLCONF": self._on_replconf})
        handlers.update({b"FLUSHDB": self._on_flush, b"FLUSHALL": self._on_flush})
        return handlers

    def _on_set(self, command: Command) -> None:
        self._put(command[1], command[2], None)

    def _on_setex(self, command: Command) -> None:
        self._put(command[1], command[3], None)

    def _on_mset(self, command: Command) -> None:
        if len(command) == 5 and command[3] == command[1] + b"@":  # the native writer's shape
            self._put(command[1], command[2], command[4])
            return
        pairs = list(zip(command[1::2], command[2::2], strict=True))
        written = dict(pairs)
        for key, value in pairs:
            if not _is_sibling(key, written):
                self._put(key, value, written.get(key + b"@"))

    def _on_delete(self, command: Command) -> None:
        deleted = dict.fromkeys(command[1:])
        for key in deleted:
            if not _is_sibling(key, deleted):
                self._put(key, None, None)

    def _on_flush(self, command: Command) -> None:
        if command[0].upper() == b"FLUSHDB" and self.selected_db != self._db:
            return
        self._writes += [Write(name, None, None, self._now_ns) for name in self._names.values()]
        self._names.clear()

    def _on_select(self, command: Command) -> None:
        self.selected_db = int(command[1])

    def _on_replconf(self, command: Command) -> None:
        self.wants_answer = command[1].upper() == b"GETACK"

    def _on_other(self, command: Command) -> None:
        if self.selected_db != self._db:
            return
        shown = b" ".join(part[:80] for part in command[:2])[:80]
        why = b"%b does not carry the whole value of its key; write with SET instead" % shown
        self._complain(command[0].upper(), why)

    def _complain(self, what: bytes, why: bytes) -> None:
        """Count a write that cannot be mirrored, and say so the first time."""
        self.not_mirrored += 1
        if what not in self._reported and len(self._reported) < _MOST_REPORTS:
            self._reported.add(what)
            log.warning("not mirrored: %s", why.decode("utf-8", "backslashreplace"))

    def _put(self, key: bytes, value: bytes | None, stamp: bytes | None) -> None:
        if self.selected_db != self._db:
            return
        if key == PROBE:
            self.probe = value or self.probe  # keep it when it expires
            return
        if len(key) > _LONGEST_KEY:
            self._complain(b"long key", b"a key of %d bytes; %d are the most that is kept" % (len(key), _LONGEST_KEY))
            return
        name = self._names.get(key)
        if name is None:
            name = self._learn(key)
        if value is None:
            del self._names[key]
        self._writes.append(Write(name, value, stamp, self._now_ns))

    def _learn(self, key: bytes) -> str:
        if len(self._names) >= _KNOWN_KEYS_LIMIT:  # somebody makes keys without end; a FLUSHDB will then miss some
            self._names.clear()
        name = self._names[key] = key_name(key)
        return name


def _is_sibling(key: bytes, written: dict[bytes, bytes] | dict[bytes, None]) -> bool:
    """Whether a key is the stamp of another key of the same command."""
    return key.endswith(b"@") and key[:-1] in written


def _ignore(command: Command) -> None:
    """Change nothing."""
