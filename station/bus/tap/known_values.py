"""What every string key of the server holds, by what its stream of writes told: for commands that change a part of it.

`APPEND` carries the end of a value, `COPY` and `RENAME` carry none. Whoever knows what a key held before knows what it
holds after them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

_MOST_BYTES = 64 << 20
_MOST_KEYS = 100_000
_LARGEST = 1 << 20  # bytes of one value; pictures have 100 kB


class KnownValues:
    """Values by database and key. Exact or unknown, never a guess.

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
        """Say what a key holds from now on."""
        if len(value) > _LARGEST:
            self.forget(db, key)
            return
        held = self._held.setdefault(db, {})
        known = held.get(key)
        self._size += len(value) - (len(known) if known is not None else 0)
        self._keys += known is None
        held[key] = value
        if self._unknown:
            self._unknown.discard((db, key))
        if self._size > _MOST_BYTES or self._keys > _MOST_KEYS:
            self._forget_all()

    def remove(self, db: int, key: bytes) -> None:
        """Say that a key is gone."""
        known = self._held.get(db, _NONE).pop(key, None)
        if known is not None:
            self._size -= len(known)
            self._keys -= 1
        self._unknown.discard((db, key))

    def forget(self, db: int, key: bytes) -> None:
        """Say that a key was changed to something unknown."""
        self.remove(db, key)
        if db in self._complete:
            self._unknown.add((db, key))
            if len(self._unknown) > _MOST_KEYS:
                self._forget_all()

    def learn(self, db: int, values: Mapping[bytes, bytes], unread: Iterable[bytes], *, is_whole: bool) -> None:
        """Take a snapshot of a database that was made at this place of the stream.

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
        """Say that a database is empty."""
        held = self._held.pop(db, {})
        self._size -= sum(map(len, held.values()))
        self._keys -= len(held)
        self._unknown = {(other, key) for other, key in self._unknown if other != db}
        self._complete.add(db)

    def forget_database(self, db: int) -> None:
        """Say that a database may hold anything."""
        self.clear(db)
        self._complete.discard(db)

    def _forget_all(self) -> None:
        self._held.clear()
        self._unknown.clear()
        self._complete.clear()
        self._size = self._keys = 0


_NONE: dict[bytes, bytes] = {}
