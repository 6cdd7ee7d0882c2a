"""The span in which a reader has heard of every write: only within it does hearing nothing mean silence. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Generic, NamedTuple, TypeVar

ValueT = TypeVar("ValueT")


class HeardSpan(NamedTuple):
    """A span of time, on the reader's monotonic clock [ns], of which no write has escaped it; empty until it begins.

    Attributes:
        since_ns: From when on it could hear without a break: before, who wrote may have been kept from it.
        until_ns: Up to when all that was written is known by now. Later writes may be on their way.
    """

    since_ns: int
    until_ns: int


class HearingProof:
    """Proves a span by questions, which the server answers on the line of its messages and in their order.

    What it told before an answer has come before the answer; so all is known that was written before the question. Of
    the time between two proofs nothing else is known: server, line or reader may have stood still for as long, and
    whoever writes was kept from it. Where that is longer than `gap_s`, the span begins anew.

    Args:
        gap_s: Longest time without a proof within a span [s].
    """

    def __init__(self, gap_s: float) -> None:
        self._gap_ns = round(gap_s * 1e9)
        self.span = HeardSpan(0, 0)

    def begin(self, now_ns: int) -> None:
        """Listen from now on: every later write will be told."""
        self.span = HeardSpan(now_ns, now_ns)

    def prove(self, asked_ns: int, now_ns: int) -> None:
        """Record an answer, once all that was told before it has been taken up.

        Args:
            asked_ns: When the question was asked.
            now_ns: When its answer was there.
        """
        is_unbroken = now_ns - self.span.until_ns <= self._gap_ns
        self.span = HeardSpan(self.span.since_ns if is_unbroken else now_ns, asked_ns)


class MissedWrites(Generic[ValueT]):
    """Finds the write that was not told of: an answer proves that the line is well, not that writes are told on it.

    All is read unasked, and then a question is put where writes are told of. By its answer every write was told of
    that had been there to be read, and the key read again; where a key was not, its notification is missing.
    """

    def __init__(self) -> None:
        self._known: dict[str, ValueT] = {}
        self._differing: dict[str, ValueT] = {}

    def record_read(self, values: Mapping[str, ValueT]) -> None:
        """Record keys that were read because something was told of them, or as the first thing."""
        self._known.update(values)
        for key in values:
            self._differing.pop(key, None)

    def record_unasked(self, values: Mapping[str, ValueT]) -> None:
        """Record keys that were read unasked, before the question is put."""
        self._differing = {key: value for key, value in values.items() if value != self._known.get(key)}

    def untold(self) -> str:
        """Return a key that was written and not told of, once the question is answered and all is read; or ""."""
        return next(iter(self._differing), "")
