"""Dropped pictures, for each camera, by the times at which they were taken."""

from __future__ import annotations

from array import array
from collections.abc import Iterable

import numpy as np

from station.episode.quality.finding_parts import CameraQuality
from station.episode.quality.findings import StreamQuality
from station.episode.reading import frames
from station.episode.reading.messages import Message


class CameraMeter:
    """Takes the messages of an episode with their stamps, and tells at the end what became of each camera's pictures.

    Args:
        cameras: Key of each camera by its name, as `station.episode.reading.frames.cameras` gives them.
    """

    def __init__(self, cameras: dict[str, str]) -> None:
        self._names = {key: name for name, key in cameras.items()}
        self._taken = {key: array("q") for key in self._names}
        self._ages = {key: array("q") for key in self._names}

    @property
    def is_needed(self) -> bool:
        """Whether there are cameras at all."""
        return bool(self._names)

    def feed(self, message: Message) -> None:
        """Take a message; those of other keys are passed over."""
        taken = self._taken.get(message.topic)
        if taken is not None and not message.channel.is_deletion:
            taken.append(frames.captured_ns(message))
            self._ages[message.topic].append(message.publish_ns - taken[-1])

    def result(self, streams: Iterable[StreamQuality]) -> list[CameraQuality]:
        """Return what became of each camera's pictures, by name; `streams` know of lost and dropped writes."""
        of_key: dict[str, list[StreamQuality]] = {key: [] for key in self._names}
        for stream in streams:
            if stream.key in of_key:
                of_key[stream.key].append(stream)
        return [self._camera(name, key, of_key[key]) for key, name in self._names.items() if len(self._taken[key])]

    def _camera(self, name: str, key: str, streams: list[StreamQuality]) -> CameraQuality:
        taken = np.sort(np.frombuffer(self._taken[key], np.int64))
        ages = np.frombuffer(self._ages[key], np.int64) * 1e-9
        intervals = np.diff(taken) * 1e-9
        beat_s = float(np.median(intervals)) if len(intervals) else 0.0
        lost = sum(stream.lost + stream.dropped for stream in streams)
        missing = max(lost, _empty_places(intervals, beat_s))
        nominal = [stream.nominal_hz for stream in streams if stream.nominal_hz is not None]
        return CameraQuality(
            name=name,
            key=key,
            frames=len(taken),
            expected=len(taken) + missing,
            missing=missing,
            lost=lost,
            drop_share=missing / (len(taken) + missing),
            rate_hz=1.0 / beat_s if beat_s > 0 else None,
            nominal_hz=max(nominal, default=None),
            longest_gap_s=float(intervals.max()) if len(intervals) else None,
            age_p50_s=float(np.percentile(ages, 50)),
            age_p99_s=float(np.percentile(ages, 99)),
        )


def _empty_places(intervals_s: np.ndarray[tuple[int], np.dtype[np.float64]], beat_s: float) -> int:
    """Return how many pictures are missing on a beat; one that is late and the next that is early make up for it."""
    if beat_s <= 0:
        return 0
    return max(0, int((np.rint(intervals_s / beat_s) - 1).sum()))
