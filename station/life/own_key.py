"""The key that is ours to write: whether somebody else writes it too, as its own writer sees it.

(`station.life.writer_conflict` is the same for who only reads a key.)
"""

from __future__ import annotations

from station.bus.sample import Sample
from station.life.server import Life
from station.life.writer_conflict import FOREIGN

_GONE_AFTER_S = 1.0


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
        """Look at the newest value of the key; call once per tick, before writing."""
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
