"""Which moments of a run are worth a picture: some of every clip, evenly, and each fall."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from station import rotations
from station.protocols import FALL_TILT_RAD, Floats
from station.view.phases import Span
from station.view.run import Run

_LYING_S = 0.8  # after a fall begins: by then one sees it
_SHORTEST_S = 0.25  # a part that is shorter gets no picture of its own
_BLENDS = frozenset(("waiting", "entering", "paused", "leaving", "done"))


class Moment(NamedTuple):
    """A row of `Run.measured`, its time [s], what was played, and whether the robot had fallen."""

    row: int
    at_s: float
    name: str
    has_fallen: bool


def moments(run: Run, count: int) -> list[Moment]:
    """Return up to `count` moments in order; none where no whole pose was recorded."""
    if run.measured is None:
        return []
    whole = np.flatnonzero(np.isfinite(run.measured.root).all(axis=1) & np.isfinite(run.measured.q).all(axis=1))
    if not len(whole):
        return []
    times_s = run.times_s[whole]
    wanted_s = instants(_parts(run, times_s), count)
    for fall_s in run.falls_s:  # in place of the nearest
        wanted_s[int(np.argmin(np.abs(wanted_s - fall_s - _LYING_S)))] = fall_s + _LYING_S
    places = np.unique(np.clip(np.searchsorted(times_s, wanted_s), 0, len(whole) - 1))
    tilt_rad = rotations.tilt(rotations.normalized(run.measured.root[whole[places], 3:]))
    return [
        Moment(int(whole[place]), float(times_s[place]), _name(run, float(times_s[place])), bool(tilt > FALL_TILT_RAD))
        for place, tilt in zip(places, tilt_rad, strict=True)
    ]


def instants(parts: Sequence[Span], count: int) -> Floats:
    """Return `count` instants: at least one in each part where they suffice, and more in longer ones.

    One stands in the middle of its part, where a squat is deepest; two at its thirds, and so on.
    With more parts than instants they are spread evenly over all, whatever plays.
    """
    lengths_s = np.array([part.end_s - part.start_s for part in parts])
    if len(parts) > count:
        start_s, end_s = parts[0].start_s, parts[-1].end_s
        return np.asarray(start_s + (end_s - start_s) * (np.arange(count) + 0.5) / count)
    shares = np.ones(len(parts), dtype=int)
    while shares.sum() < count:  # the next picture goes where a picture stands for most time
        shares[int(np.argmax(lengths_s / shares))] += 1
    return np.concatenate(
        [part.start_s + (part.end_s - part.start_s) * (np.arange(share) + 1) / (share + 1)
         for part, share in zip(parts, shares, strict=True)]
    )  # fmt: skip


def _parts(run: Run, times_s: Floats) -> list[Span]:
    """Return what was played while the robot's pose was recorded; the whole recording where nothing says."""
    first_s, last_s = float(times_s[0]), float(times_s[-1])
    parts = [
        Span(max(span.start_s, first_s), min(span.end_s, last_s), span.name)
        for span in run.phases
        if span.name not in _BLENDS
    ]
    return [part for part in parts if part.end_s - part.start_s >= _SHORTEST_S] or [Span(first_s, last_s, "")]


def _name(run: Run, at_s: float) -> str:
    return next((span.name for span in run.phases if span.start_s <= at_s <= span.end_s), "")
