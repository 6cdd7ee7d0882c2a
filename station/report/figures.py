"""Figures of a data set: takes per hour, successes, reasons, lengths. Every one says of what it was made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np

from station.episode.quality.findings import Verdict
from station.report.gather import Episode

BREAK_S = 900.0
"""A longer time between the end of a take and the start of the next is a break, and no work."""

VERDICTS: tuple[Verdict, ...] = ("good", "usable", "reject")
_BARS = 24
_STEPS_S = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600)


class Pace(NamedTuple):
    """How fast takes were made: takes in sessions of at least two, hours of these sessions, and how many there were."""

    takes: int
    good: int
    hours: float
    sessions: int

    @property
    def per_hour(self) -> float | None:
        """Takes per hour of session; None without a session."""
        return self.takes / self.hours if self.hours > 0 else None

    @property
    def good_per_hour(self) -> float | None:
        """Takes per hour that are no reject."""
        return self.good / self.hours if self.hours > 0 else None


class Bin(NamedTuple):
    """A bar of the histogram of lengths: from, to [s], and how many of each verdict."""

    from_s: float
    to_s: float
    counts: dict[Verdict, int]


def pace(episodes: Sequence[Episode]) -> Pace:
    """Return how fast takes were made, from the first start of a session to its last end, resets included.

    A take that stands alone between two breaks says nothing of a pace and is left out.
    """
    timed = [(started, episode) for episode in episodes if (started := episode.started) is not None]
    timed.sort(key=lambda take: take[0])
    sessions: list[list[tuple[datetime, Episode]]] = []
    end: datetime | None = None
    for started, episode in timed:
        if end is None or (started - end).total_seconds() > BREAK_S:
            sessions.append([])
            end = started
        sessions[-1].append((started, episode))
        end = max(end, _end(started, episode))
    long = [session for session in sessions if len(session) > 1]
    seconds = sum((max(_end(*take) for take in one) - one[0][0]).total_seconds() for one in long)
    takes = [episode for session in long for _, episode in session]
    return Pace(len(takes), sum(take.quality.verdict != "reject" for take in takes), seconds / 3600, len(long))


def counts(episodes: Sequence[Episode]) -> dict[Verdict, int]:
    """Return how many episodes have each verdict."""
    found = Counter(episode.quality.verdict for episode in episodes)
    return {verdict: found[verdict] for verdict in VERDICTS}


def lengths(episodes: Sequence[Episode]) -> list[Bin]:
    """Return a histogram of lengths with round limits, and at most 24 bars."""
    if not episodes:
        return []
    values = np.array([episode.quality.length_s for episode in episodes])
    first, last = float(values.min()), float(values.max())
    step = next((step for step in _STEPS_S if (last // step) - (first // step) < _BARS), (last - first) / _BARS + 1.0)
    start = first // step * step
    bins = [
        Bin(start + n * step, start + (n + 1) * step, dict.fromkeys(VERDICTS, 0))
        for n in range(int((last - start) // step) + 1)
    ]
    for episode in episodes:
        place = min(int((episode.quality.length_s - start) // step), len(bins) - 1)
        bins[place].counts[episode.quality.verdict] += 1
    return bins


def reasons(episodes: Sequence[Episode]) -> list[tuple[str, int, int, str]]:
    """Return for each rule that spoke its name, in how many episodes as reject and as usable, and one of its texts."""
    found: dict[str, list[int | str]] = {}
    for episode in episodes:
        of_rule: dict[str, Verdict] = {}
        for reason in episode.quality.reasons:
            if of_rule.get(reason.rule) != "reject":
                of_rule[reason.rule] = reason.verdict
            found.setdefault(reason.rule, [0, 0, reason.text])
        for rule, verdict in of_rule.items():
            place = 0 if verdict == "reject" else 1
            found[rule][place] = int(found[rule][place]) + 1
    rows = [(rule, int(reject), int(usable), str(text)) for rule, (reject, usable, text) in found.items()]
    return sorted(rows, key=lambda row: (-row[1], -row[2], row[0]))


def _end(started: datetime, episode: Episode) -> datetime:
    seconds = episode.manifest.timing.duration_s
    return started + timedelta(seconds=min(max(0.0, episode.quality.length_s if seconds is None else seconds), 1e8))
