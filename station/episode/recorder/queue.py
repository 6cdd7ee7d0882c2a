"""The queue before the disk: bounded, in order of arrival, and when it fills up images go before signals."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from station.episode.storage.drops import Drops, is_bulky

if TYPE_CHECKING:
    from station.bus.tap import Position, Write

_ROOM = 8  # one in so many parts of the queue is made free at a time, since looking for what to throw out takes a while
_MOST_KEYS = 1000


class Batch(msgspec.Struct):
    """Writes that came together.

    Attributes:
        writes, size: What is left of them, and the bytes of their values.
        position: The tap's position after the last of them.
        is_live, is_whole, is_held: As in `EpisodeWriter.put`.
        drops: What was dropped of them, and of what came between them and the next batch; None for nothing.
    """

    writes: Sequence[Write]
    size: int = 0
    position: Position | None = None
    is_live: bool = True
    is_whole: bool = True
    is_held: bool = False
    drops: Drops | None = None

    def lose(self, drops: Drops) -> None:
        """Count something as dropped at this place of the stream."""
        if self.drops is None:
            self.drops = Drops()
        self.drops.add(drops)


class WriteQueue:
    """Writes on their way to the disk. Not for two threads at once: the owner has a lock.

    Up to half of the bytes everything is taken. From there to three quarters bulky values (`drops.is_bulky`) are
    thinned out: of each key one in 2, 4, … 32 is kept, so a disk that is too slow leaves a lower frame rate and no long
    hole; beyond that, none. So a quarter is always left for signals, and a signal that finds no room even so throws
    out the oldest bulky values that wait. A signal is dropped only when nothing but signals waits, apart from what the
    thread that writes has in hand already and from the pre-roll, which takes no room here.

    Args:
        most_writes, most_bytes: Its bounds: number of writes, and bytes of their values.

    Attributes:
        writes, size: Of what is queued or being written.
    """

    def __init__(self, most_writes: int, most_bytes: int) -> None:
        self.writes = self.size = self._held = 0
        self._most_writes = most_writes
        self._most_bytes = most_bytes
        self._plenty = most_bytes // 2
        self._most_with_bulky = most_bytes * 3 // 4
        self._batches: deque[Batch] = deque()
        self._may_hold_bulky = False
        self._skipped: dict[str, int] = {}  # bulky values of a key that were dropped since the last one that was kept

    def __bool__(self) -> bool:
        """Whether something waits."""
        return bool(self._batches)

    @property
    def load(self) -> float:
        """How full it is, 0..1; from a half on bulky values are dropped."""
        return max(self.writes / self._most_writes, self.size / self._most_bytes)

    def put(self, batch: Batch) -> Drops | None:
        """Add a batch at the end; return what had to be dropped for it, of it or of what waited before it."""
        size = sum([len(write[1]) for write in batch.writes if write[1] is not None])
        if batch.is_held:
            self._held += len(batch.writes)
            self._batches.append(batch)
            return None
        count = len(batch.writes)
        if self.size + size <= self._plenty and self.writes + count <= self._most_writes:
            batch.size = size
            self.size += size
            self.writes += count
            self._may_hold_bulky = self._may_hold_bulky or size > 0
            self._append(batch)
            return None
        drops = self._put_some(batch)
        return drops if drops.total else None

    def pop(self, most_bytes: int) -> list[Batch]:
        """Return the oldest batches, as many as hold so many bytes, at least one; say `done` after each."""
        found: list[Batch] = []
        size = 0
        while self._batches and (not found or size < most_bytes):
            found.append(self._batches.popleft())
            size += found[-1].size
        return found

    def done(self, batch: Batch) -> None:
        """Forget a batch that was taken and is written."""
        if batch.is_held:
            self._held -= len(batch.writes)
        else:
            self.writes -= len(batch.writes)
            self.size -= batch.size

    def clear(self) -> int:
        """Forget everything; return how many writes that were."""
        waiting = self.writes + self._held
        self._batches.clear()
        self.writes = self.size = self._held = 0
        return waiting

    def _append(self, batch: Batch) -> None:
        if batch.writes or not self._batches:
            self._batches.append(batch)
            return
        last = self._batches[-1]  # what holds no writes is no batch: any number of those may come
        last.position, last.is_whole = batch.position, batch.is_whole
        if batch.drops is not None:
            last.lose(batch.drops)

    def _put_some(self, batch: Batch) -> Drops:
        """Add of a batch what there is room for."""
        kept: list[Write] = []
        drops, lost, evicted = Drops(), Drops(), Drops()
        incoming, batch.writes = batch.writes, kept
        for write in incoming:
            size = len(write[1]) if write[1] is not None else 0
            bulky = is_bulky(write[0], size)
            if not (self._admits(write[0], size) if bulky else self._fits(size) or self._evict(size, batch, evicted)):
                lost.count(write, is_bulky=bulky)
                continue
            batch.writes.append(write)
            batch.size += size
            self.writes += 1
            self.size += size
            self._may_hold_bulky |= bulky
        if lost.total:
            batch.lose(lost)
        drops.add(lost)
        drops.add(evicted)
        self._append(batch)
        return drops

    def _fits(self, size: int) -> bool:
        return self.writes < self._most_writes and self.size + size <= self._most_bytes

    def _admits(self, key: str, size: int) -> bool:
        """Whether to take a bulky value."""
        most = self._most_with_bulky if self.size else self._most_bytes
        if self.writes >= self._most_writes or self.size + size > most:
            return False
        over = self.size - self._plenty
        if over < 0:
            return True
        one_in = 2 << min(4, over * 5 // max(1, self._most_with_bulky - self._plenty))
        if len(self._skipped) > _MOST_KEYS:
            self._skipped.clear()
        skipped = self._skipped.get(key, 0) + 1
        self._skipped[key] = skipped % one_in
        return skipped >= one_in

    def _evict(self, size: int, newest: Batch, evicted: Drops) -> bool:
        """Throw bulky values out, the oldest first, to make room for a signal; return whether there is room now."""
        if self._may_hold_bulky and size <= self._most_bytes:
            bytes_owed = self.size + size - self._most_bytes + self._most_bytes // _ROOM
            writes_owed = self.writes + 1 - self._most_writes + self._most_writes // _ROOM
            for batch in (*self._batches, newest):
                if bytes_owed <= 0 and writes_owed <= 0:
                    break
                if batch.is_held:
                    continue
                bytes_before, count_before = batch.size, len(batch.writes)
                drops = _without_bulky(batch)
                evicted.add(drops)
                self.size -= bytes_before - batch.size
                self.writes -= count_before - len(batch.writes)
                bytes_owed -= bytes_before - batch.size
                writes_owed -= count_before - len(batch.writes)
            else:
                self._may_hold_bulky = False
        return self._fits(size)


def _without_bulky(batch: Batch) -> Drops:
    """Remove the bulky values from a batch and return what they were."""
    drops, kept, size = Drops(), [], 0
    for write in batch.writes:
        bytes_ = len(write[1]) if write[1] is not None else 0
        if is_bulky(write[0], bytes_):
            drops.count(write, is_bulky=True)
        else:
            kept.append(write)
            size += bytes_
    if drops.total:
        batch.writes, batch.size = kept, size
        batch.lose(drops)
    return drops
