"""Dropped pictures, for each camera, by the times at which they were taken.

The beat of a camera is the mean of its usual intervals, those between a half of the median and one and a half of it;
the median itself would be wrong where times lie on a coarser clock, such as a simulation's. Pictures are then put on
the beat one after another, and the places between them are counted; the beat follows the pictures slowly, so that
neither one that is late nor a clock that drifts is taken for a hole.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence

import msgspec
import numpy as np

from station.bus import codec
from station.episode.quality.finding_parts import CameraQuality
from station.episode.quality.findings import StreamQuality
from station.episode.reading import frames
from station.episode.reading.messages import Ints, Message
from station.episode.storage import pictures
from station.episode.storage.manifest import Manifest
from station.protocols import Floats


def stated_hz(manifest: Manifest) -> dict[str, float]:
    """Return the rate that each camera gives by the word of its server, by its key [Hz]."""
    told = (one for facts in (*manifest.cameras, *manifest.servers.values()) for one in pictures.stated(facts))
    stated = ((facts.get("key"), facts.get("fps")) for facts in told)
    return {key: hz for key, fps in stated if isinstance(key, str) and (hz := codec.number(fps)) is not None and hz > 0}


def told_apart(cameras: Sequence[CameraQuality]) -> list[CameraQuality]:
    """Return the cameras whose times are worth a word: depth that came with each picture has those of its camera."""
    times = {camera.name: msgspec.structs.replace(camera, name="", key="") for camera in cameras}
    return [
        camera
        for camera in cameras
        if not camera.name.endswith(pictures.DEPTH_ENDING)
        or times.get(camera.name.removesuffix(pictures.DEPTH_ENDING)) != times[camera.name]
    ]


_FOLLOWED = 0.1
"""Of the distance between a picture and its place on the beat: by so much the beat follows."""

_CLOCKS_NS = 10_000_000_000
"""A picture that was taken longer than this after its write has the time of another clock, which says nothing."""


class CameraMeter:
    """Takes the messages of an episode with their stamps, and tells at the end what became of each camera's pictures.

    Args:
        cameras: Key of each camera by its name, as `station.episode.reading.frames.all_pictures` gives them.
        stated_hz: Rate that each camera was set to, by its key, where that was stated; as `stated_hz` gives them.
    """

    def __init__(self, cameras: dict[str, str], stated_hz: Mapping[str, float]) -> None:
        self._stated_hz = stated_hz
        self._names = {key: name for name, key in cameras.items()}
        self._taken = {key: array("q") for key in self._names}
        self._ages = {key: array("q") for key in self._names}
        self._ahead_ns: dict[str, int] = {}

    @property
    def is_needed(self) -> bool:
        """Whether there are cameras at all."""
        return bool(self._names)

    def feed(self, message: Message) -> None:
        """Add a message; those of other keys are passed over."""
        taken = self._taken.get(message.topic)
        if taken is not None and not message.channel.is_deletion:
            taken.append(frames.captured_ns(message))
            age_ns = message.publish_ns - taken[-1]
            self._ages[message.topic].append(age_ns)
            if age_ns == 0 and -_CLOCKS_NS < (stated_ns := pictures.stated_age_ns(message.stamp) or 0) < 0:
                self._ahead_ns[message.topic] = max(self._ahead_ns.get(message.topic, 0), -stated_ns)

    def result(self, streams: Iterable[StreamQuality], start_ns: int) -> list[CameraQuality]:
        """Return what became of each camera's pictures, by name; `streams` know of lost and dropped writes.

        Times are told from `start_ns` [ns since the epoch].
        """
        of_key: dict[str, list[StreamQuality]] = {key: [] for key in self._names}
        for stream in streams:
            if stream.key in of_key:
                of_key[stream.key].append(stream)
        return [
            self._camera(name, key, of_key[key], start_ns) for key, name in self._names.items() if len(self._taken[key])
        ]

    def _camera(self, name: str, key: str, streams: list[StreamQuality], start_ns: int) -> CameraQuality:
        taken = np.sort(np.frombuffer(self._taken[key], np.int64))
        ages = np.frombuffer(self._ages[key], np.int64) * 1e-9
        intervals = np.diff(taken) * 1e-9
        gap = int(intervals.argmax()) if len(intervals) else None
        beat_s = _beat_s(intervals)
        lost = sum(stream.lost + stream.dropped for stream in streams)
        missing = max(lost, _empty_places(taken, round(beat_s * 1e9)))
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
            nominal_hz=self._stated_hz.get(key, max(nominal, default=None)),
            longest_gap_s=None if gap is None else float(intervals[gap]),
            gap_at_s=None if gap is None else round((int(taken[gap]) - start_ns) * 1e-9, 3),
            age_p50_s=float(np.percentile(ages, 50)),
            age_p99_s=float(np.percentile(ages, 99)),
            ahead_s=self._ahead_ns.get(key, 0) * 1e-9,
        )


def _beat_s(intervals_s: Floats) -> float:
    """Return the usual time from picture to picture [s]; 0 for fewer than two pictures."""
    if not len(intervals_s):
        return 0.0
    median = np.median(intervals_s)
    return float(intervals_s[np.abs(intervals_s - median) <= 0.5 * median].mean())


def _empty_places(taken_ns: Ints, beat_ns: int) -> int:
    """Return how many places on a beat are empty; one that is late and the next that is early make up for it."""
    if beat_ns <= 0:
        return 0
    empty, place = 0, float(taken_ns[0])
    for taken in taken_ns[1:].tolist():
        steps = round((taken - place) / beat_ns)
        empty += steps - 1
        place += steps * beat_ns
        place += _FOLLOWED * (taken - place)
    return max(0, empty)
