"""Notices two writers of one key: a robot that obeys two operators in turn. Pure; its time is given.

A writer is the source in its stamps, or `FOREIGN`: two that write without stamps cannot be told apart.
(`station.control.command_arbiter` decides which of them is obeyed.)
"""

from __future__ import annotations

from station.bus.sample import Sample
from station.life.server import Life

FOREIGN = "foreign"
"""How a writer without stamps is called."""

_GONE_AFTER_S = 1.0


class WriterConflict:
    """Publishes once that two writers of a key alternate.

    One writer that follows another (a server that was restarted) is no rival: only one that writes again after the
    other did, within the window, is.

    Args:
        window_s: How near the writes of two writers must be [s].
    """

    def __init__(self, window_s: float = 1.0) -> None:
        self._window_s = window_s
        self._turns: list[tuple[str, float]] = []  # last write of each turn, newest last
        self._reported: frozenset[str] = frozenset()

    def see(self, writer: str, now_s: float) -> tuple[str, ...]:
        """Record a write; return the rivals, sorted, when they are newly found, else nothing."""
        if self._turns and self._turns[-1][0] == writer:
            self._turns.pop()
        self._turns.append((writer, now_s))
        self._turns = [turn for turn in self._turns if now_s - turn[1] <= self._window_s][-8:]
        names = [name for name, _ in self._turns]
        found = frozenset(names) if len(set(names)) < len(names) else frozenset()
        if len(set(names)) == 1:
            self._reported = frozenset()  # alone again: a later rival is news
        if not found or found <= self._reported:
            return ()
        self._reported = found
        return tuple(sorted(found))


class OwnKey:
    """Turns what is seen on our own key into one event when a rival appears and one when it is gone.

    Args:
        life: Says the events; its bus is the rightful writer.
        key: The key that only we should write.
    """

    def __init__(self, life: Life, key: str) -> None:
        self._life, self._key = life, key
        self._since_ns = life.clock.monotonic_ns()
        self._writers: set[str] = set()
        self._newest: Sample | None = None
        self._count = 0

    def check(self, sample: Sample | None) -> None:
        """Check the newest value of the key; call once per tick, before writing."""
        if sample is not None and sample is not self._newest and self._is_rival(sample):
            self._see(sample)
        elif self._newest is not None and self._newest.age_s(self._life.clock.monotonic_ns()) > _GONE_AFTER_S:
            self._life.event("second-writer", key=self._key, writers=sorted(self._writers), ended=True,
                             writes_seen=self._count)  # fmt: skip
            self._writers, self._newest, self._count = set(), None, 0

    def _is_rival(self, sample: Sample) -> bool:
        # What was there before we began is the last word of an earlier session.
        if sample.arrived_ns is None or sample.arrived_ns < self._since_ns:
            return False
        return sample.stamp is None or sample.stamp.source != self._life.bus.source

    def _see(self, sample: Sample) -> None:
        writer = FOREIGN if sample.stamp is None else sample.stamp.source
        self._newest = sample
        self._count += 1
        if writer not in self._writers:
            self._writers.add(writer)
            self._life.event("second-writer", severity="warning", key=self._key, writers=sorted(self._writers))
