"""Commands that ended because their server said so, and began again: a device was away, a motion was over.

A server that falls silent is a fault; one that has said that it will be silent is none. Every command server says so
with an event of its own, and `_ENDS` is where the check knows them from.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.episode.quality.findings import CommandPause
from station.episode.quality.interruptions import late_s
from station.episode.reading.reader import Message

Ints = NDArray[np.int64]

MOST_ENDS = 1000
"""Ends that are looked at; a file that was built to harm may hold millions."""

_LEAST_NS = 250_000_000  # a shorter silence is none: the gate still holds the last command, or has just begun to return
_LONGEST_TEXT = 300
_ENDS = {
    "teleop-commands-end": "the operator's commands ended",
    "operator-exit": "the operator left",
    "motion-end": "the motion was over",
}
"""Events that say that commands end, with the reason where they give none."""


class End(NamedTuple):
    """A command server said that its commands end: its source, when [ns since the epoch], and why."""

    source: str
    at_ns: int
    reason: str


class WriteTimes(NamedTuple):
    """When one source wrote one command key [ns since the epoch], sorted."""

    key: str
    source: str
    times: Ints


class Span(NamedTuple):
    """No commands from one instant to another [ns since the epoch]: on which keys, who had written them, and why."""

    from_ns: int
    to_ns: int
    keys: list[str]
    source: str
    reason: str


def end_of(message: Message, event: Mapping[str, Any]) -> End | None:
    """Return the end of commands that a recorded event tells of, or None when it tells of none."""
    otherwise = _ENDS.get(str(event.get("name")))
    if otherwise is None:
        return None
    detail = event.get("detail")
    reason = detail.get("reason") if isinstance(detail, Mapping) else None
    text = str(reason)[:_LONGEST_TEXT] if reason else otherwise
    return End(message.channel.source, message.publish_ns - int(late_s(event) * 1e9), text)


def told(times: Ints, ends: Iterable[End]) -> NDArray[np.bool_]:
    """Return which intervals between the sorted times of a stream its writer had told of, shape (len(times) - 1,)."""
    found = np.zeros(max(0, len(times) - 1), dtype=np.bool_)
    for end in ends:
        before = _before(times, end.at_ns)
        if 0 <= before < len(found) and times[before + 1] - times[before] > _LEAST_NS:
            found[before] = True
    return found


def spans(times: Ints, paused: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return from when to when a stream was written, its pauses left out [ns since the epoch]."""
    if not len(times):
        return []
    cuts = np.flatnonzero(paused)
    begins, finishes = [times[0], *times[cuts + 1]], [*times[cuts], times[-1]]
    return [(int(begin), int(finish)) for begin, finish in zip(begins, finishes, strict=True)]


def find(spoken: Iterable[WriteTimes], ends: Sequence[End]) -> list[Span]:
    """Return when a robot had no commands because their writer had ended them, until anybody commanded again.

    What ended for good is no pause. Keys that fell silent with one end are one pause, of the longest of them.
    """
    by_key: dict[str, list[WriteTimes]] = defaultdict(list)
    for one in spoken:
        by_key[one.key].append(one)
    found: dict[End, Span] = {}
    for key, group in by_key.items():
        for end, (from_ns, to_ns) in _of_key(group, ends).items():
            here = Span(from_ns, to_ns, [key], end.source, end.reason)
            known = found.get(end, here)
            longest = max(known, here, key=lambda span: span.to_ns - span.from_ns)
            found[end] = longest._replace(keys=sorted({*known.keys, key}))
    return sorted(found.values())


def described(spans: Iterable[Span], start_ns: int) -> list[CommandPause]:
    """Return the pauses as a check reports them, their times from `start_ns`."""
    return [
        CommandPause(
            at_s=round((span.from_ns - start_ns) * 1e-9, 3),
            seconds=round((span.to_ns - span.from_ns) * 1e-9, 3),
            keys=span.keys,
            writer=span.source.split(".", 1)[0],
            reason=span.reason,
        )
        for span in spans
    ]


def _of_key(group: Sequence[WriteTimes], ends: Iterable[End]) -> dict[End, tuple[int, int]]:
    """Return the pause of one key after each end that had one [ns since the epoch]."""
    times = np.concatenate([one.times for one in group])
    writers = np.repeat(np.arange(len(group)), [len(one.times) for one in group])
    order = np.argsort(times, kind="stable")
    times, writers = times[order], writers[order]
    last = {one.source: _before(times, int(one.times[-1])) for one in group if len(one.times)}
    numbers = {one.source: number for number, one in enumerate(group)}
    found = {}
    for end in ends:
        if end.source not in last:
            continue
        before, final = _before(times, end.at_ns), last[end.source]
        if before >= 0 and writers[before] == numbers[end.source] and _is_pause(times, before):
            found[end] = int(times[before]), int(times[before + 1])
        elif times[final] > end.at_ns and _is_pause(times, final):  # a blend to standing followed, and nothing else
            found[end] = int(times[final]), int(times[final + 1])
    return found


def _before(times: Ints, at_ns: int) -> int:
    """Return the index of the newest of the sorted times up to an instant; -1 when there is none."""
    return int(np.searchsorted(times, at_ns, side="right")) - 1


def _is_pause(times: Ints, index: int) -> bool:
    return index + 1 < len(times) and bool(times[index + 1] - times[index] > _LEAST_NS)
