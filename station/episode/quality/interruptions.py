"""Interruptions of the bus and of the recorder's link, from the recorded events and the manifest: one line for each.

Every server tells of what it suffered, so a bus that was silent for two seconds is told of by all of them; what they
suffered at the same time is put together here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import Any, Literal, get_args

import msgspec

from station.episode.quality.findings import Interruption
from station.episode.storage.manifest import Manifest

_MOST = 1000  # events that are looked at; a file that was built to harm may hold millions
_TOGETHER_S = 0.5  # servers that write twice a second notice as much later than others

_LONGEST_TEXT = 300
_LONGEST_S = 1e9  # also keeps out what is not finite

_Kind = Literal["bus-silent", "bus-lost", "bus-refused", "bulk-cut", "watch-cut", "tap-cut"]
_EVENTS: dict[str, _Kind] = {
    "bus-silent": "bus-silent",
    "bus-back": "bus-lost",
    "bus-lost": "bus-lost",
    "bus-refused": "bus-refused",
    "watch-back": "watch-cut",
    "tap-resumed": "tap-cut",
}


def find(events: Iterable[tuple[float, Mapping[str, Any]]], manifest: Manifest) -> list[Interruption]:
    """Return the interruptions of an episode in the order of their beginnings; none that was over before its start.

    Args:
        events: Recorded events, each with its time from the start of the episode [s].
        manifest: The episode's, which knows of holes and restarts.
    """
    of_interest = ((at_s, event) for at_s, event in events if str(event.get("name")) in _EVENTS)
    told = [_from_event(at_s, event) for at_s, event in islice(of_interest, _MOST)]
    found = [item for kind in get_args(_Kind) for item in _together([one for one in told if one.kind == kind])]
    whole = [item for item in found if item.kind in ("bus-silent", "bus-lost")]
    found = [item for item in found if item.kind != "watch-cut" or not any(_meet(item, other) for other in whole)]
    found += [*_holes(manifest), *_restarts(manifest), *_end(manifest)]
    return sorted((item for item in found if _end_s(item) >= 0), key=lambda item: item.at_s)


def late_s(event: Mapping[str, Any]) -> float:
    """Return how long after it happened an event was said [s], because the bus did not take it before."""
    detail = event.get("detail")
    return max(0.0, _number(detail.get("late_s"), 0.0)) if isinstance(detail, Mapping) else 0.0


def _from_event(at_s: float, event: Mapping[str, Any]) -> Interruption:
    detail = event.get("detail")
    detail = detail if isinstance(detail, Mapping) else {}
    seconds = _number(detail.get("seconds"), 0.0)
    kind = _EVENTS[str(event["name"])]
    lost = detail.get("refused" if kind == "bus-refused" else "lost_writes", 0 if kind == "tap-cut" else None)
    if detail.get("bus") == "bulk" and kind != "tap-cut":
        kind = "bulk-cut"
    return Interruption(
        kind=kind,
        at_s=round(at_s - _number(detail.get("began_ago_s"), seconds), 3),
        seconds=seconds,
        lost=lost if isinstance(lost, int) else None,
        told_by=[str(event.get("source", ""))[:_LONGEST_TEXT]],
        reason=str(detail.get("reason", ""))[:_LONGEST_TEXT],
    )


def _together(items: Iterable[Interruption]) -> list[Interruption]:
    """Make one of those that several servers told of at the same time."""
    found: list[Interruption] = []
    for item in sorted(items, key=lambda one: one.at_s):
        if found and item.kind != "tap-cut" and _meet(found[-1], item):
            found[-1] = _both(found[-1], item)
        else:
            found.append(item)
    return found


def _both(one: Interruption, other: Interruption) -> Interruption:
    counted = [item.lost for item in (one, other) if item.lost is not None]
    return msgspec.structs.replace(
        one,
        seconds=round(max(_end_s(one), _end_s(other)) - one.at_s, 3),
        lost=sum(counted) if counted else None,
        told_by=sorted({*one.told_by, *other.told_by}),
        reason=one.reason or other.reason,
    )


def _meet(one: Interruption, other: Interruption) -> bool:
    return one.at_s <= _end_s(other) + _TOGETHER_S and other.at_s <= _end_s(one) + _TOGETHER_S


def _end_s(item: Interruption) -> float:
    return item.at_s + (item.seconds or 0.0)


def _holes(manifest: Manifest) -> list[Interruption]:
    return [
        Interruption(
            kind="hole", at_s=hole.from_s, lost=hole.lost, told_by=["recorder"], reason=hole.reason,
            seconds=None if hole.to_s is None else round(hole.to_s - hole.from_s, 3),
        )
        for hole in manifest.holes
    ]  # fmt: skip


def _restarts(manifest: Manifest) -> list[Interruption]:
    return [_restart(note) for note in manifest.recovery if note.get("kind") == "resumed"]


def _restart(note: Mapping[str, Any]) -> Interruption:
    away_s, is_exact = _number(note.get("away_s"), 0.0), note.get("by") == "offset"
    return Interruption(
        kind="recorder-restart",
        at_s=round(_number(note.get("at_s"), 0.0) - away_s, 3),
        seconds=away_s,
        lost=0 if is_exact else None,
        told_by=["recorder"],
        reason="went on where it was" if is_exact else "could not go on where it was",
    )


def _end(manifest: Manifest) -> list[Interruption]:
    """Return the loss of which no event could tell: the one that ended the episode."""
    if manifest.recorder.ended_by != "bus-lost":
        return []
    reason = "it did not come back, and the recorder ended the episode"
    return [Interruption(kind="bus-lost", at_s=manifest.timing.duration_s or 0.0, told_by=["recorder"], reason=reason)]


def _number(value: object, otherwise: float) -> float:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < _LONGEST_S
    return float(value) if isinstance(value, (int, float)) and is_number else otherwise
