"""What changes in what a camera shows: views that are turned, exchanged, blurred, cut or noise.

Everything follows from the small grey pictures of `station.episode.quality.picture_contents`, two a second. Those that
show nothing, for want of light or for too much of it, tell nothing here.

* Noise: a lens spreads every point over its neighbours, so the Laplacian of a picture varies less than its grey does.
  White noise has 20 times as much; pictures of simulations 0.25 to 1.3 times. That ratio is called sharpness here.
* Blurred: below 0.02 in the median picture: nothing in view is smaller than a tenth of the picture. Or focus that goes
  in the middle: from one picture to the next, which shows the same, to a quarter, and below a third ever after.
* Turned: once, a picture is not like the one before (correlation below 0.5), but like it turned by half a turn (0.9),
  while those before and those after are like each other.
* Exchanged: in the same second two cameras stop being like themselves, and each is like the other one was.
* Cut: a lower quarter or more that is of one colour, where that of the first picture is not.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from station.episode.quality.finding_parts import Seen
from station.episode.reading.messages import Ints
from station.protocols import Floats

TILES = 12
"""Rows and columns of the means that views are compared by."""

_NOISE = 4.0  # of the variance of grey, in that of the Laplacian
_LIKE, _UNLIKE = 0.9, 0.5
_FALLS, _STAYS = 0.25, 1.0 / 3.0
_TOGETHER_NS = 1_000_000_000
_MOST_CHANGES = 100


class Change(NamedTuple):
    """A picture that is not like the one before: when it was taken [ns], and both, as means of tiles."""

    at_ns: int
    before: Floats
    after: Floats


class Views(NamedTuple):
    """What became of the views of a camera; times are from the start of the episode [s].

    Attributes:
        noise, turned, cut: Pictures that are noise, that are turned by half a turn, and of which the lower end is gone.
        relative_sharpness: Median of the sharpness of the pictures; None for none.
        focus_lost_s: When the focus went; None where it stayed.
    """

    noise: Seen
    turned: Seen
    cut: Seen
    relative_sharpness: float | None
    focus_lost_s: float | None


class ViewMeter:
    """Takes what the pictures of one camera show, in their order.

    Attributes:
        changes: Pictures that are not like the one before.
    """

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self._times = array("q")
        self._thumbs: list[Floats] = []
        self._sharpness = array("d")
        self._likeness = array("d")
        self._cut: list[bool] = []
        self._turned: list[int] = []

    def add(self, taken_ns: int, thumb: Floats, sharpness: float | None, *, is_cut: bool) -> None:
        """Add the next picture: means of tiles, and its sharpness; None for one that shows nothing."""
        like = likeness(self._thumbs[-1], thumb) if self._thumbs else 1.0
        if like < _UNLIKE and len(self.changes) < _MOST_CHANGES:
            before = self._thumbs[-1]
            self.changes.append(Change(taken_ns, before, thumb))
            if likeness(before[::-1, ::-1], thumb) > _LIKE:
                self._turned.append(len(self._times))
        self._times.append(taken_ns)
        self._thumbs.append(thumb)
        self._sharpness.append(math.nan if sharpness is None else sharpness)
        self._likeness.append(like)
        self._cut.append(is_cut and sharpness is not None)

    def result(self, start_ns: int) -> Views:
        """Return what became of the views."""
        times = np.frombuffer(self._times, np.int64) if self._times else np.empty(0, np.int64)
        sharpness = np.array(self._sharpness)
        seen = sharpness[np.isfinite(sharpness)]
        cut = [at_ns for at_ns, is_cut in zip(self._times, self._cut, strict=True) if is_cut and not self._cut[0]]
        return Views(
            noise=_seen(times[sharpness > _NOISE].tolist(), start_ns),
            turned=_seen(self._lasting_turn(), start_ns),
            cut=_seen(cut, start_ns),
            relative_sharpness=round(float(np.median(seen)), 4) if len(seen) else None,
            focus_lost_s=self._focus_lost_s(times, sharpness, start_ns),
        )

    def _lasting_turn(self) -> list[int]:
        """Return when the camera turned [ns], if it did once, and stood still before and after."""
        if len(self._turned) != 1:
            return []
        (index,) = self._turned
        around = [self._likeness[place] for place in (index - 1, index + 1) if 0 < place < len(self._likeness)]
        return [self._times[index]] if len(around) == 2 and min(around) > _LIKE else []

    def _focus_lost_s(self, times: Ints, sharpness: Floats, start_ns: int) -> float | None:
        for index in range(1, len(sharpness)):
            falls = sharpness[index] < _FALLS * sharpness[index - 1] and self._likeness[index] > _LIKE
            if falls and np.nanmedian(sharpness[index:]) < _STAYS * np.nanmedian(sharpness[:index]):
                return round(float(times[index] - start_ns) * 1e-9, 3)
        return None


def exchanged(meters: dict[str, ViewMeter]) -> dict[str, tuple[str, int]]:
    """Return the cameras that changed places in the middle, by name: with which other one, and when first [ns]."""
    found: dict[str, tuple[str, int]] = {}
    for (one, left), (other, right) in combinations(meters.items(), 2):
        for a in left.changes:
            for b in right.changes:
                is_both = likeness(a.after, b.before) > _LIKE and likeness(b.after, a.before) > _LIKE
                if abs(a.at_ns - b.at_ns) <= _TOGETHER_NS and is_both:
                    found.setdefault(one, (other, a.at_ns))
                    found.setdefault(other, (one, b.at_ns))
    return found


def likeness(one: Floats, other: Floats) -> float:
    """Return how alike two views are but for brightness and contrast, up to 1; 0 where one shows nothing."""
    a, b = one - one.mean(), other - other.mean()
    size = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _seen(times: Sequence[int], start_ns: int) -> Seen:
    return Seen(len(times), round((times[0] - start_ns) * 1e-9, 3) if times else None)
