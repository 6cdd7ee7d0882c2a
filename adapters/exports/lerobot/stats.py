"""Statistics as LeRobot keeps them: least, greatest, mean, deviation, count and quantiles, per episode and in total.

Everything here is exact but two things, so that memory does not grow with the data set: quantiles of the total come
from histograms of 4096 bins between least and greatest, and pictures are sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.exports.lerobot import depth_codes
from station.protocols import Floats

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
ORDER = ("min", "max", "mean", "std", "count", *QUANTILES)

Stats = dict[str, list[float]]
"""By the names in `ORDER`: a number per element; ``count`` has one number, how many rows."""

_BINS = 4096
_LEVELS = 256
_MOST_SAMPLES = 100
_SAMPLED_SIDE = 160  # pixels; a picture is thinned out until its longer side has no more


def of_rows(values: NDArray[Any]) -> Stats:
    """Return the statistics of a column, shape (n,) or (n, m), n at least 1."""
    rows = values.reshape(len(values), -1).astype(np.float64)
    quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0)
    found = {
        "min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0),
        "count": np.array([len(rows)]), **dict(zip(QUANTILES, quantiles, strict=True)),
    }  # fmt: skip
    return {name: found[name].tolist() for name in ORDER}


class Totals:
    """Statistics of one column over all episodes: first `know` each episode, then `add` the rows of each."""

    def __init__(self) -> None:
        self._count = 0
        self._mean = self._square = self._min = self._max = np.empty(0)
        self._bins = np.empty((0, _BINS), dtype=np.int64)

    def know(self, episode: Stats) -> None:
        """Add the statistics of an episode."""
        count = int(episode["count"][0])
        least, greatest, mean, std = (np.array(episode[name]) for name in ("min", "max", "mean", "std"))
        if not self._count:
            self._min, self._max = least, greatest
            self._mean, self._square = np.zeros(len(mean)), np.zeros(len(mean))
        before, self._count = self._count, self._count + count
        step = mean - self._mean
        self._mean = self._mean + step * count / self._count
        self._square = self._square + count * std**2 + step**2 * before * count / self._count
        self._min, self._max = np.minimum(self._min, least), np.maximum(self._max, greatest)

    def add(self, values: NDArray[Any]) -> None:
        """Count the rows of an episode, shape (n,) or (n, m), after all episodes are known."""
        rows = values.reshape(len(values), -1).astype(np.float64)
        if not len(self._bins):
            self._bins = np.zeros((rows.shape[1], _BINS), dtype=np.int64)
        width = np.where(self._max > self._min, self._max - self._min, 1.0)
        place = ((rows - self._min) / width * _BINS).astype(np.int64).clip(0, _BINS - 1)
        place += np.arange(rows.shape[1]) * _BINS
        self._bins += np.bincount(place.ravel(), minlength=self._bins.size).reshape(self._bins.shape)

    def result(self) -> Stats:
        """Return the statistics; every episode has been added."""
        std = np.sqrt(self._square / self._count)
        found = {"min": self._min, "max": self._max, "mean": self._mean, "std": std}
        width = (self._max - self._min) / _BINS
        for name, share in QUANTILES.items():
            place = np.array([_quantile(counts, share) for counts in self._bins])
            found[name] = np.clip(self._min + place * width, self._min, self._max)
        stats = {name: values.tolist() for name, values in found.items()}
        return {name: [self._count] if name == "count" else stats[name] for name in ORDER}


class PixelCounts:
    """How often each brightness was seen in each colour, over sampled pictures; adds up over episodes.

    Of depth how often each code was, which has more of them than brightness, and one channel: by that it is known.
    """

    def __init__(self, counts: Sequence[Sequence[int]] | None = None, pictures: int = 0) -> None:
        self._counts = np.zeros((3, _LEVELS), dtype=np.int64) if counts is None else np.array(counts, dtype=np.int64)
        self.pictures = pictures

    @classmethod
    def of_depth(cls) -> PixelCounts:
        """Return counts of depth, none so far."""
        return cls([[0] * depth_codes.CODES])

    @staticmethod
    def samples(rows: int) -> list[int]:
        """Return the rows whose pictures are sampled: all, or a hundred at even distances."""
        return sorted(set(np.linspace(0, rows - 1, min(rows, _MOST_SAMPLES)).round().astype(int).tolist()))

    def add(self, rgb: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Count the pixels of a picture, shape (height, width, channels)."""
        step = -(-max(rgb.shape[:2]) // _SAMPLED_SIDE)
        channels, levels = self._counts.shape
        for channel in range(channels):
            self._counts[channel] += np.bincount(rgb[::step, ::step, channel].ravel(), minlength=levels)
        self.pictures += 1

    def merge(self, other: PixelCounts) -> None:
        """Add what another one has counted; the first one says of what."""
        self._counts = other._counts + (self._counts if self.pictures else 0)
        self.pictures += other.pictures

    def plain(self) -> dict[str, Any]:
        """Return it as values that JSON can hold, for `PixelCounts(**…)`."""
        return {"counts": self._counts.tolist(), "pictures": self.pictures}

    def stats(self) -> Stats:
        """Return the statistics of the colours, 0 to 1, or of depth [mm]; the count is of pictures."""
        is_colour = self._counts.shape[1] == _LEVELS
        levels = np.arange(_LEVELS) / (_LEVELS - 1) if is_colour else depth_codes.millimetres()
        total = self._counts.sum(axis=1)
        mean = self._counts @ levels / total
        seen = [levels[counts > 0] for counts in self._counts]
        found = {
            "min": np.array([values[0] for values in seen]), "max": np.array([values[-1] for values in seen]),
            "mean": mean, "std": np.sqrt(np.maximum(self._counts @ levels**2 / total - mean**2, 0.0)),
            "count": np.array([self.pictures]),
        }  # fmt: skip
        for name, share in QUANTILES.items():
            place = [np.searchsorted(counts.cumsum(), share * counts.sum()) for counts in self._counts]
            found[name] = levels[np.clip(place, 0, len(levels) - 1)]
        return {name: found[name].tolist() for name in ORDER}


def as_image(stats: Mapping[str, list[float]]) -> dict[str, Any]:
    """Return statistics of channels in the shape that LeRobot gives those of pictures: (channels, 1, 1)."""
    return {name: values if name == "count" else [[[value]] for value in values] for name, values in stats.items()}


def _quantile(counts: NDArray[np.int64], share: float) -> float:
    """Return where in a histogram a share of all lies below, in bins."""
    above = counts.cumsum()
    wanted = share * above[-1]
    index = int(np.searchsorted(above, wanted))
    before: Floats = above[index] - counts[index]
    return index + float((wanted - before) / max(counts[index], 1))
