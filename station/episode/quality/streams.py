"""Counts, rates and losses of every stream, in one pass over the messages."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from station.episode.quality import pauses
from station.episode.quality.findings import RivalWriters, StreamQuality
from station.episode.quality.pauses import End, WriteTimes
from station.episode.reading.reader import Channel, Message
from station.episode.storage import layout
from station.episode.storage.drops import Drops

Ints = NDArray[np.int64]
_WRAP = 1 << 32  # an MCAP sequence number has 32 bits; a stamp's own has no end


class StreamCounter:
    """Takes every message of an episode and tells at the end what each stream was like."""

    def __init__(self) -> None:
        self._channels: dict[int, Channel] = {}
        self._times: dict[int, array[int]] = {}
        self._numbers: dict[int, array[int]] = {}

    def feed(self, message: Message) -> None:
        """Count a message."""
        channel = message.channel
        if channel.id not in self._channels:
            self._channels[channel.id] = channel
            self._times[channel.id], self._numbers[channel.id] = array("q"), array("q")
        self._times[channel.id].append(message.publish_ns)
        self._numbers[channel.id].append(message.sequence)

    def streams(self, start_ns: int, drops: Drops, ends: Sequence[End] = ()) -> list[StreamQuality]:
        """Return every stream, by key and writer; times are told from `start_ns`.

        What the recorder dropped knowingly is told as that, and not as lost. An interval in which a writer had said
        that its commands end is no gap.
        """
        found = []
        for number, channel in self._channels.items():
            times = np.sort(_ints(self._times[number]))
            paused = pauses.told(times, _own(ends, channel))
            found.append(_measure(channel, times, _ints(self._numbers[number]), paused, start_ns, drops))
        return sorted(found, key=lambda stream: (stream.key, stream.writer, stream.first_s))

    def commands(self) -> Iterator[WriteTimes]:
        """Yield when each source wrote each command key."""
        for number, channel in self._channels.items():
            if _is_command(channel):
                yield WriteTimes(channel.topic, channel.source, np.sort(_ints(self._times[number])))

    @property
    def messages(self) -> int:
        """Messages counted."""
        return sum(len(times) for times in self._times.values())


def rivals(spoken: Iterable[WriteTimes], ends: Sequence[End] = ()) -> list[RivalWriters]:
    """Return the command keys that several sources wrote during the same time; one after the other is fine."""
    by_key: dict[str, list[tuple[str, list[tuple[int, int]]]]] = {}
    for one in spoken:
        spans = pauses.spans(one.times, pauses.told(one.times, [end for end in ends if end.source == one.source]))
        by_key.setdefault(one.key, []).append((one.source.split(".", 1)[0] or layout.FOREIGN, spans))
    return [
        RivalWriters(key, sorted({writer, other}), overlap_ns * 1e-9)
        for key, group in by_key.items()
        for (writer, spans), (other, others) in combinations(group, 2)
        if (overlap_ns := _overlap_ns(spans, others)) > 0
    ]


def _overlap_ns(spans: list[tuple[int, int]], others: list[tuple[int, int]]) -> int:
    return sum(
        max(0, min(to_ns, other_to) - max(from_ns, other_from))
        for from_ns, to_ns in spans
        for other_from, other_to in others
    )


def _own(ends: Sequence[End], channel: Channel) -> list[End]:
    """Return the ends of commands that the writer of a channel of commands told of."""
    return [end for end in ends if end.source == channel.source] if _is_command(channel) else []


def _is_command(channel: Channel) -> bool:
    return channel.contract is not None and channel.contract.role == "command" and not channel.is_deletion


def _ints(values: array[int]) -> Ints:
    return np.frombuffer(values, dtype=np.int64)


def _measure(
    channel: Channel, times: Ints, numbers: Ints, paused: NDArray[np.bool_], start_ns: int, drops: Drops
) -> StreamQuality:
    missing, repeated, out_of_order, hole = _by_number(numbers) if channel.is_native else (0, 0, 0, None)
    dropped, bulky = (0, 0) if channel.is_deletion else drops.of(channel.topic, channel.source)
    every = np.diff(times) * 1e-9
    intervals = every[~paused]
    span_s = float(intervals.sum())
    gap = int(np.where(paused, -1.0, every).argmax()) if len(intervals) else None
    median_s = float(np.median(intervals)) if len(intervals) else 0.0
    jitter = np.abs(intervals - median_s)
    contract = channel.contract
    second = round(1.0 / median_s) if median_s > 0 else 0  # a device may have a rate of its own
    there = times[:-1]  # the last write of a device is its word that it has ended, long after the others
    slow = int((there[second:] - there[:-second]).argmax()) if 0 < second < len(there) else None
    return StreamQuality(
        key=channel.topic,
        source=channel.source,
        writer=channel.writer,
        role=contract.role if contract else "unknown",
        is_native=channel.is_native,
        count=len(times),
        lost=max(0, missing - dropped),
        dropped=dropped,
        dropped_bulky=bulky,
        repeated=repeated,
        out_of_order=out_of_order,
        rate_hz=len(intervals) / span_s if span_s > 0 else None,
        nominal_hz=contract.rate_hz if contract and not channel.is_deletion else None,
        jitter_p50_s=float(np.percentile(jitter, 50)) if len(jitter) else None,
        jitter_p99_s=float(np.percentile(jitter, 99)) if len(jitter) else None,
        longest_gap_s=None if gap is None else float(every[gap]),
        lost_at_s=_at_s(times, hole, start_ns),
        slowest_s=None if slow is None else float(there[slow + second] - there[slow]) * 1e-9,
        slowest_at_s=_at_s(times, slow, start_ns),
        gap_at_s=_at_s(times, gap, start_ns),
        first_s=float(times[0] - start_ns) * 1e-9,
        last_s=float(times[-1] - start_ns) * 1e-9,
        paused_s=float(every[paused].sum()),
    )


def _at_s(times: Ints, index: int | None, start_ns: int) -> float | None:
    return None if index is None else round(float(times[index] - start_ns) * 1e-9, 3)


def _by_number(numbers: Ints) -> tuple[int, int, int, int | None]:
    """Return how many sequence numbers are missing, repeated, and smaller than the one before.

    And how many messages have smaller ones than the first that is missing, less one; None where none is missing.
    """
    steps = (np.diff(numbers) + _WRAP // 2) % _WRAP - _WRAP // 2
    unwrapped = np.concatenate([[0], np.cumsum(steps)])
    there = np.unique(unwrapped)
    lost = int(there[-1] - there[0]) + 1 - len(there)
    hole = int((np.diff(there) > 1).argmax()) if lost else None
    return lost, len(numbers) - len(there), int(np.count_nonzero(steps < 0)), hole
