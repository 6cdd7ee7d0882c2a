"""From the bytes of a replication stream to writes, with exact account of the bytes.

The stream is a sequence of commands, each a RESP array of bulk strings. There is one canonical way to encode such
an array and the server uses it, so the length of a command on the wire follows from its parsed form. That is needed
because hiredis does not say how many bytes it has consumed, and a wrong count by one byte breaks every resumption.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Container, Iterable, Mapping

import hiredis

from station.bus.server_options import LARGEST_VALUE
from station.bus.tap.base import PROBE, Snapshot, Write, key_name
from station.bus.tap.dumped import string_in
from station.bus.tap.not_mirrored import not_mirrored
from station.clock import SYSTEM, Clock
from station.errors import BusError

log = logging.getLogger(__name__)

_KNOWN_KEYS_LIMIT = 100_000
_MOST_REPORTS = 50
_LONGEST_KEY = 4096  # bytes; names are remembered, and the server takes some as long as values
_KEY_AT = {b"BITOP": 2, b"XGROUP": 2, b"EVAL": 3, b"EVALSHA": 3, b"FCALL": 3}  # where the key stands; else first
# Commands that arrive on the link and change no value of a string key.
_SILENT = frozenset(
    b"PING MULTI EXEC EXPIRE EXPIREAT PEXPIRE PEXPIREAT PERSIST PUBLISH SPUBLISH SCRIPT FUNCTION".split()
)

Command = list[bytes]

MOST_BYTES = 64 << 20  # of all values that are known
_MOST_KEYS = 100_000
LARGEST_KNOWN = 1 << 20  # bytes of one of them; pictures have 100 kB


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
        clock: Of the tap's reader.

    Attributes:
        offset: Bytes of the server's history up to the end of the last whole command.
        selected_db: Database selected there.
        awaited: Value of the probe key that is to come by; None once it has, whatever other taps write there after it.
        wants_answer: Whether the server asked for an acknowledgement; sending it resets this.
        snapshot: What the tapped database held when a probe was written; taken in when that probe comes by.

    A command that does not carry the whole value of its key (APPEND, COPY, RENAME …) is a write of that value where it
    is known what the key held before. Where it is not, a write of `keys.NOT_MIRRORED` names command and key.
    """

    def __init__(self, *, db: int, offset: int, selected_db: int, clock: Clock = SYSTEM) -> None:
        self.offset = offset
        self.selected_db = selected_db
        self.awaited: bytes | None = None
        self.wants_answer = False
        self.snapshot: Snapshot | None = None
        self._db, self._clock = db, clock
        self._values = KnownValues()
        self._reader = hiredis.Reader()
        self._reader.setmaxbuf(1 << 20)  # keep the buffer between values of 60 KB instead of growing it each time
        self._fed = offset
        self._names: dict[bytes, str] = {}  # also tells which keys a FLUSHDB takes away
        self._reported: set[bytes] = set()
        self._writes: list[Write] = []
        self._now_ns = 0
        self._handlers = self._make_handlers()

    def feed(self, data: bytes | memoryview) -> list[Write]:
        """Parse bytes off the wire and return the writes that they complete.

        Raises:
            BusError: the bytes are no commands.
        """
        if self._fed == self.offset and data[:1] == b"\n":
            data = bytes(data).lstrip(b"\n")  # keep-alive between two commands; the server does not count it either
        self._fed += len(data)
        self._now_ns = self._clock.monotonic_ns()
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
        handlers.update({b"FLUSHDB": self._on_flush, b"FLUSHALL": self._on_flush, b"SWAPDB": self._on_swap})
        handlers.update(dict.fromkeys(PARTIAL, self._on_partial))
        handlers.update(dict.fromkeys((b"RENAME", b"RENAMENX"), self._on_rename))
        handlers.update({b"COPY": self._on_copy, b"MOVE": self._on_move, b"RESTORE": self._on_restore})
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
            if _is_sibling(key, deleted):
                self._values.remove(self.selected_db, key)
            else:
                self._put(key, None, None)

    def _on_flush(self, command: Command) -> None:
        is_all = command[0].upper() == b"FLUSHALL"
        for db in self._values.databases | {self._db} if is_all else {self.selected_db}:
            self._values.clear(db)
        if is_all or self.selected_db == self._db:
            self._writes += [Write(name, None, None, self._now_ns) for name in self._names.values()]
            self._names.clear()

    def _on_swap(self, command: Command) -> None:
        swapped = int(command[1]), int(command[2])
        for db in swapped:
            self._values.forget_database(db)
        if self._db in swapped:
            self._miss(command, b"", self._db)

    def _on_partial(self, command: Command) -> None:
        before = self._values.get(self.selected_db, command[1])
        value = after(command, before) if before is not None else None
        self._put_or_miss(command, command[1], value, self.selected_db)

    def _on_rename(self, command: Command) -> None:
        self._transfer(command, command[1], command[2], self.selected_db, is_moved=True)

    def _on_move(self, command: Command) -> None:
        self._transfer(command, command[1], command[1], int(command[2]), is_moved=True)

    def _on_copy(self, command: Command) -> None:
        options = [part.upper() for part in command[3:]]
        to_db = int(options[options.index(b"DB") + 1]) if b"DB" in options else self.selected_db
        self._transfer(command, command[1], command[2], to_db, is_moved=False)

    def _on_restore(self, command: Command) -> None:
        self._put_or_miss(command, command[1], string_in(command[3]), self.selected_db)

    def _transfer(self, command: Command, source: bytes, target: bytes, to_db: int, *, is_moved: bool) -> None:
        """Record that a key got the value of another one, which may be gone by it."""
        value = self._values.get(self.selected_db, source)
        if is_moved:
            self._put(source, None, None)
        self._put_or_miss(command, target, value, to_db)

    def _put_or_miss(self, command: Command, key: bytes, value: bytes | None, db: int) -> None:
        if value is None:
            self._miss(command, key, db)
        else:
            self._put(key, value, None, db=db)

    def _on_select(self, command: Command) -> None:
        self.selected_db = int(command[1])

    def _on_replconf(self, command: Command) -> None:
        self.wants_answer = command[1].upper() == b"GETACK"

    def _on_other(self, command: Command) -> None:
        place = _KEY_AT.get(command[0].upper(), 1)
        self._miss(command, command[place] if len(command) > place else b"", self.selected_db)

    def _miss(self, command: Command, key: bytes, db: int) -> None:
        """Report a change that cannot be shown: it does not carry the whole value, and what was there is unknown."""
        self._values.forget(db, key)
        if db == self._db:
            self._report(command[0].upper(), key, "what its key holds now is not in it; write with SET instead")

    def _report(self, what: bytes, key: bytes, why: str) -> None:
        said = not_mirrored(what, key)
        self._writes.append(said.write(self._now_ns))
        if what not in self._reported and len(self._reported) < _MOST_REPORTS:
            self._reported.add(what)
            log.warning("not mirrored: %s %s: %s", said.command, said.key[:80], why)

    def _put(self, key: bytes, value: bytes | None, stamp: bytes | None, *, db: int | None = None) -> None:
        db = self.selected_db if db is None else db
        if value is None:
            self._values.remove(db, key)
        else:
            self._values.put(db, key, value)
            if stamp is not None:
                self._values.put(db, key + b"@", stamp)
        if db != self._db:
            return
        if key == PROBE:
            self._on_probe(value)
            return
        if len(key) > _LONGEST_KEY:
            self._report(b"SET", key, f"a key of {len(key)} bytes; {_LONGEST_KEY} are the most that is kept")
            return
        name = self._names.get(key)
        if name is None:
            name = self._learn(key)
        if value is None:
            del self._names[key]
        self._writes.append(Write(name, value, stamp, self._now_ns))

    def _on_probe(self, value: bytes | None) -> None:
        if value == self.awaited:
            self.awaited = None
        snapshot = self.snapshot
        if snapshot is None or value != snapshot.probe:
            return
        self.snapshot = None
        self._values.learn(self._db, snapshot.values, snapshot.unread, is_whole=snapshot.is_whole)
        for key in (*snapshot.values, *snapshot.unread):
            if not _is_sibling(key, snapshot.values) and len(key) <= _LONGEST_KEY and key != PROBE:
                self._learn(key)

    def _learn(self, key: bytes) -> str:
        if len(self._names) >= _KNOWN_KEYS_LIMIT:  # a client makes keys without end; a FLUSHDB will then miss some
            self._names.clear()
        name = self._names[key] = key_name(key)
        return name


def _is_sibling(key: bytes, written: Container[bytes]) -> bool:
    """Whether a key is the stamp of another key of the same command."""
    return key.endswith(b"@") and key[:-1] in written


def _ignore(command: Command) -> None:
    """Change nothing."""


def after(command: Command, before: bytes) -> bytes | None:
    """Return what the key of a command of `PARTIAL` holds after it.

    Args:
        command: The command.
        before: What the key held; b"" where it did not exist.

    Returns:
        The value; None where it would be larger than a bus of ours takes.
    """
    name = command[0].upper()
    reach = int(command[2]) // _PER_BYTE[name] if name in _PER_BYTE else 0
    return PARTIAL[name](before, command) if reach <= LARGEST_VALUE else None


def _set_range(before: bytes, command: Command) -> bytes:
    start, part = int(command[2]), command[3]
    return before[:start].ljust(start, b"\0") + part + before[start + len(part) :]


def _set_bit(before: bytes, command: Command) -> bytes:
    place, bit = int(command[2]), int(command[3])
    value = bytearray(before.ljust(place // 8 + 1, b"\0"))
    mask = 0x80 >> place % 8
    value[place // 8] = value[place // 8] & ~mask | (mask if bit else 0)
    return bytes(value)


def _step(sign: int, step: int | None = None) -> Callable[[bytes, Command], bytes]:
    """Return what adds a step, or what the command says, to a decimal number; a key that does not exist counts as 0."""
    return lambda before, command: b"%d" % (int(before or b"0") + sign * (int(command[2]) if step is None else step))


_PER_BYTE = {b"SETRANGE": 1, b"SETBIT": 8}  # places that a byte has, of commands that name one
PARTIAL: dict[bytes, Callable[[bytes, Command], bytes]] = {
    b"APPEND": lambda before, command: before + command[2],
    b"SETRANGE": _set_range,
    b"SETBIT": _set_bit,
    b"INCR": _step(1, 1),
    b"DECR": _step(-1, 1),
    b"INCRBY": _step(1),
    b"DECRBY": _step(-1),
}
"""By command: from what its key held before to what it holds afterwards."""


class KnownValues:
    """What every string key of the server holds, by database and key, as its stream told. Exact or unknown, no guess.

    `APPEND` carries the end of a value, `COPY` and `RENAME` carry none: by what a key held before it is known what it
    holds after them.

    A database of which a whole snapshot was taken (`learn`), or that was flushed, is complete: a key that is not known
    there does not exist. Beyond 64 MiB or 100,000 keys everything is forgotten, and no database is complete.
    """

    def __init__(self) -> None:
        self._held: dict[int, dict[bytes, bytes]] = {}
        self._unknown: set[tuple[int, bytes]] = set()
        self._complete: set[int] = set()
        self._size = 0
        self._keys = 0

    def get(self, db: int, key: bytes) -> bytes | None:
        """Return what a key holds, b"" where it does not exist; None where that is not known."""
        value = self._held.get(db, _NONE).get(key)
        if value is None and db in self._complete and (db, key) not in self._unknown:
            return b""
        return value

    def put(self, db: int, key: bytes, value: bytes) -> None:
        """Set what a key holds from now on."""
        if len(value) > LARGEST_KNOWN:
            self.forget(db, key)
            return
        held = self._held.setdefault(db, {})
        known = held.get(key)
        self._size += len(value) - (len(known) if known is not None else 0)
        self._keys += known is None
        held[key] = value
        if self._unknown:
            self._unknown.discard((db, key))
        if self._size > MOST_BYTES or self._keys > _MOST_KEYS:
            self._forget_all()

    def remove(self, db: int, key: bytes) -> None:
        """Record that a key is gone."""
        known = self._held.get(db, _NONE).pop(key, None)
        if known is not None:
            self._size -= len(known)
            self._keys -= 1
        self._unknown.discard((db, key))

    def forget(self, db: int, key: bytes) -> None:
        """Record that a key was changed to something unknown."""
        self.remove(db, key)
        if db in self._complete:
            self._unknown.add((db, key))
            if len(self._unknown) > _MOST_KEYS:
                self._forget_all()

    def learn(self, db: int, values: Mapping[bytes, bytes], unread: Iterable[bytes], *, is_whole: bool) -> None:
        """Apply a snapshot of a database that was made at this place of the stream.

        Args:
            db: The database.
            values: What its string keys hold.
            unread: Keys that are there and were not read.
            is_whole: Whether these are all its keys.
        """
        if is_whole:
            self._complete.add(db)
        for key, value in values.items():
            self.put(db, key, value)
        for key in unread:
            self.forget(db, key)

    @property
    def databases(self) -> set[int]:
        """The databases of which anything is known."""
        return {*self._held, *self._complete}

    def clear(self, db: int) -> None:
        """Record that a database is empty."""
        held = self._held.pop(db, {})
        self._size -= sum(map(len, held.values()))
        self._keys -= len(held)
        self._unknown = {(other, key) for other, key in self._unknown if other != db}
        self._complete.add(db)

    def forget_database(self, db: int) -> None:
        """Record that a database may hold anything."""
        self.clear(db)
        self._complete.discard(db)

    def _forget_all(self) -> None:
        self._held.clear()
        self._unknown.clear()
        self._complete.clear()
        self._size = self._keys = 0


_NONE: dict[bytes, bytes] = {}
