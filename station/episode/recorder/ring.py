"""The newest writes of the bus, kept so that an episode can begin before its button was pressed."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from station.bus.tap import Position, Write


_WRITE_BYTES = 300  # of a write with its stamp, beside its value
_PARTS = 4


class Ring:
    """Writes of the last seconds, bounded by time and by bytes; what falls out at the old end is meant to.

    Args:
        seconds: How far back it reaches [s]; 0 keeps nothing.
        max_bytes: Bound of its memory; with fast cameras on the bus it reaches less far back. A value of more than a
            quarter of that is not kept: everything before it would have to go.
    """

    def __init__(self, seconds: float, max_bytes: int = 256 * 1024 * 1024) -> None:
        self._span_ns = int(seconds * 1e9)
        self._max_bytes = max_bytes
        self._batches: deque[tuple[Sequence[Write], int, Position | None]] = deque()
        self._bytes = 0

    @property
    def size(self) -> int:
        """Bytes that are kept."""
        return self._bytes

    def add(self, writes: Sequence[Write], before: Position | None = None) -> None:
        """Keep writes, in the order of their arrival; the sequence must not change afterwards.

        Args:
            writes: What arrived.
            before: A place of the tap that none of them lies before.
        """
        if not writes or not self._span_ns:
            return
        size = sum([len(write.value) for write in writes if write.value is not None])
        if size > self._max_bytes // _PARTS:
            writes = [write for write in writes if len(write.value or b"") <= self._max_bytes // _PARTS]
            size = sum(len(write.value or b"") for write in writes)
        if not writes:
            return
        size += _WRITE_BYTES * len(writes)
        self._batches.append((writes, size, before))
        self._bytes += size
        oldest_ns = writes[-1].mono_ns - self._span_ns
        while self._batches and (self._bytes > self._max_bytes or self._batches[0][0][-1].mono_ns < oldest_ns):
            self._bytes -= self._batches.popleft()[1]

    def since(self, mono_ns: int) -> list[Write]:
        """Return what is kept of the span that ends at a monotonic instant [ns], oldest first."""
        oldest_ns = mono_ns - self._span_ns
        return [write for writes, _, _ in self._batches for write in writes if write.mono_ns >= oldest_ns]

    def place(self, mono_ns: int) -> Position | None:
        """Return the tap's place before everything that `since` returns; None when nothing is kept, or no place."""
        oldest_ns = mono_ns - self._span_ns
        return next((before for writes, _, before in self._batches if writes[-1].mono_ns >= oldest_ns), None)

    def clear(self) -> None:
        """Forget everything: after a hole, what came before it must not pass for what came just before."""
        self._batches.clear()
        self._bytes = 0
