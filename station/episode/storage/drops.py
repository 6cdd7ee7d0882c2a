"""Writes that the recorder saw and did not keep, counted per key and writer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from station.bus.contracts import contract
from station.contract import Contract
from station.episode.storage import layout
from station.episode.storage.bulk import names_of
from station.episode.storage.channels import Channel, source_of, topic_of
from station.episode.storage.manifest import Stream
from station.life.events import Severity

if TYPE_CHECKING:
    from station.bus.tap import Write

OTHERS = "(others)"
"""Stands for all keys beyond the first `MOST_NAMES`: a client that invents keys must not fill the memory."""

MOST_NAMES = 1000
_BULKY_BYTES = 16 * 1024  # without a contract; a state has 1 kB, an observation 6 kB, a small but useful JPEG 20 kB
_LARGEST_SIGNAL = 1 << 20  # whatever its contract: the longest runbook takes some kB


class Dropped(NamedTuple):
    """How many writes of one key by one source are not in the file, and how many of them were bulky."""

    key: str
    source: str
    writes: int
    bulky: int


class Drops:
    """Counts dropped writes.

    Attributes:
        total, bulky: All of them, and those that were bulky.
    """

    __slots__ = ("_counts", "bulky", "total")

    def __init__(self, known: Iterable[Dropped] = ()) -> None:
        self._counts: dict[tuple[str, str], list[int]] = {}
        self.total = self.bulky = 0
        for one in known:
            self._add(*one)

    def count(self, write: Write, *, is_bulky: bool) -> None:
        """Count one write."""
        source = source_of(write.stamp) if write.value is not None else None
        self._add(topic_of(write.key), source or "", 1, int(is_bulky))

    def add(self, others: Drops) -> None:
        """Count what another has counted as well."""
        for one in others:
            self._add(*one)

    def of(self, key: str, source: str) -> tuple[int, int]:
        """Return how many writes of a key by a source were dropped, and how many of them were bulky."""
        count, bulky = self._counts.get((key, source), (0, 0))
        return count, bulky

    def only(self, *, is_bulky: bool) -> Drops:
        """Return the bulky ones of them, or the others."""
        found = (one._replace(writes=one.bulky if is_bulky else one.writes - one.bulky) for one in self)
        return Drops(one._replace(bulky=one.writes * is_bulky) for one in found if one.writes)

    def by_key(self, most: int) -> dict[str, int]:
        """Return the keys that lost most, with how many."""
        found: dict[str, int] = {}
        for key, _, count, _ in self:
            found[key] = found.get(key, 0) + count
        return dict(sorted(found.items(), key=lambda item: -item[1])[:most])

    def __iter__(self) -> Iterator[Dropped]:
        for (key, source), (count, bulky) in list(self._counts.items()):
            yield Dropped(key, source, count, bulky)

    def _add(self, key: str, source: str, count: int, bulky: int) -> None:
        name = (key, source)
        if name not in self._counts and len(self._counts) >= MOST_NAMES:
            name = (OTHERS, "")
        counts = self._counts.setdefault(name, [0, 0])
        counts[0] += count
        counts[1] += bulky
        self.total += count
        self.bulky += bulky


def is_bulky(key: str, size: int) -> bool:
    """Whether a value of so many bytes is one that can be spared before signals: an image, a point cloud, a blob."""
    if size > _LARGEST_SIGNAL:
        return True
    known = contract(key)
    return size > _BULKY_BYTES if known is None else names_of(key) is not layout.SIGNALS_NAMES


def larger(one: Drops, other: Drops) -> Drops:
    """Return of two counts of the same file, which only ever grow, the later one for each stream."""
    names = {(found.key, found.source) for found in (*one, *other)}
    return Drops(Dropped(*name, *map(max, one.of(*name), other.of(*name))) for name in sorted(names))


def drops_record(drops: Drops) -> dict[str, str]:
    """Return the counts as a metadata record of the file has them."""
    streams = msgspec.json.encode(list(drops)).decode()
    return {"dropped": str(drops.total), "bulky": str(drops.bulky), "streams": streams}


def drops_of(record: dict[str, str] | None) -> Drops:
    """Return the counts of such a record; none where there is no record, or no readable one."""
    try:
        return Drops(msgspec.json.decode(record["streams"], type=list[Dropped]) if record else ())
    except (KeyError, msgspec.DecodeError, RecursionError):
        return Drops()


def streams_of(
    channels: Iterable[Channel], drops: Drops, start_ns: int, contract_of: Callable[[str], Contract | None] = contract
) -> list[Stream]:
    """Return the manifest's entry of every channel, and behind them of keys that were dropped to the last write."""
    owed = {(one.key, one.source): (one.writes, one.bulky) for one in drops}
    found = []
    for channel in channels:
        name = (channel.topic, channel.source) if channel.encoding != layout.DELETED else None
        found.append(channel.stream(start_ns, owed.pop(name, (0, 0)) if name else (0, 0)))
    for (key, source), dropped in owed.items():
        file = names_of(key).final
        found.append(Channel(0, key, source, "", file, contract_of(key)).stream(start_ns, dropped))
    return found


class DropPeriods:
    """Says when writes begin to be dropped and when that is over, not each time that it happens.

    Args:
        name, severity: Of the event.
    """

    QUIET_S = 2.0

    def __init__(self, name: str, severity: Severity) -> None:
        self._name = name
        self._severity = severity
        self._drops: Drops | None = None
        self._is_said = False
        self._began_s = self._last_s = 0.0

    def add(self, drops: Drops, now_s: float) -> None:
        """Add what was dropped just now [s, monotonic], if anything was."""
        if not drops.total:
            return
        if self._drops is None:
            self._drops, self._is_said, self._began_s = Drops(), False, now_s
        self._drops.add(drops)
        self._last_s = now_s

    def poll(self, now_s: float) -> Iterator[tuple[str, Severity, dict[str, Any]]]:
        """Return the events that are due: name, severity, numbers."""
        if self._drops is None:
            return
        if not self._is_said:
            self._is_said = True
            yield self._name, self._severity, {"dropped": self._drops.total, "keys": self._drops.by_key(5)}
        elif now_s - self._last_s > self.QUIET_S:
            seconds = round(self._last_s - self._began_s, 3)
            count, names = self._drops.total, self._drops.by_key(10)
            yield self._name, self._severity, {"ended": True, "seconds": seconds, "dropped": count, "keys": names}
            self._drops = None
