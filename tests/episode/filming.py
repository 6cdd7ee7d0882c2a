"""Episodes with pictures beside signals, written by the real writer in flushes that are chosen here."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.tap import Write
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import Anchor, read_anchor
from station.episode.storage.manifest import Manifest, Task, Timing
from station.episode.storage.progress import WriterOptions
from station.episode.writing.closing import close_manifest
from station.point_cloud import PointCloud, PointField, SensorPose, encoded
from tests.episode.writes import Native
from tests.waiting import DEADLINE_S, wait_until

BODY = twist_keys.action_body()
HEAD, WRIST = keys.camera_image("head"), keys.camera_image("wrist")
CLOUD = keys.lidar_cloud("top")
_XYZ = tuple(PointField(axis, 4 * number, "<f4") for number, axis in enumerate("xyz"))
EXPOSED_NS = 20_000_000  # from the capture of a picture to its write


def jpeg(number: int, size: int = 2000) -> bytes:
    """Bytes that nothing makes smaller, and that no other number has."""
    return b"\xff\xd8" + number.to_bytes(4, "big") + random.Random(number).randbytes(size - 8) + b"\xff\xd9"


def cloud(number: int, points: int = 100) -> bytes:
    """A cloud that no other number has; its first tenth are points without a return."""
    rows = np.random.default_rng(number).normal(size=(points, 3)).astype(np.float32)
    rows[: points // 10] = 0.0
    return encoded(PointCloud("torso", SensorPose((0.0, 0.0, 1.0)), 12, _XYZ, rows.tobytes(), number))


class Scene:
    """A robot, two cameras and a lidar; every write has a number and arrives after the one before it."""

    def __init__(self) -> None:
        self.anchor: Anchor = read_anchor()
        self._g1, self._camera, self._lidar = Native(), Native("camera"), Native("top")
        self._now_ns, self._number = self.anchor.mono_ns, 0

    def signals(self, count: int) -> list[Write]:
        return [self._dated(self._g1, BODY, codec.json_vector([float(self._next())] * 35)) for _ in range(count)]

    def picture(self, key: str = HEAD, size: int = 2000, data: bytes = b"") -> Write:
        number = self._next()
        taken_ns = self._now_ns - EXPOSED_NS
        return self._camera.write(key, data or jpeg(number, size), written_ns=self._now_ns, capture_ns=taken_ns)

    def cloud(self, data: bytes = b"") -> Write:
        value, taken_ns = data or cloud(self._next()), self._now_ns - EXPOSED_NS
        return self._lidar.write(CLOUD, value, written_ns=self._now_ns, capture_ns=taken_ns)

    def _next(self) -> int:
        self._number += 1
        self._now_ns += 1_000_000
        return self._number

    def _dated(self, source: Native, key: str, value: bytes) -> Write:
        return source.write(key, value, written_ns=self._now_ns)


def film(
    folder: Path, batches: Sequence[Sequence[Write]], anchor: Anchor, *, flush_bytes: int = 1, **fields: Any
) -> Manifest:
    """Record batches, each flushed by itself, and close the episode; return its manifest, which has further fields."""
    folder.mkdir(parents=True, exist_ok=True)
    timing = Timing(anchor=anchor, started="2026-11-21T10:00:00+00:00")
    manifest = Manifest(episode_id=folder.name, task=Task(name="walk"), timing=timing, **fields)
    options = WriterOptions(flush_bytes=flush_bytes)
    writer = EpisodeWriter(folder, anchor=anchor, manifest=manifest, options=options, start_id="s")
    written = 0
    for batch in batches:
        writer.put(list(batch))
        written += len(batch)
        wait_until(lambda n=written: writer.messages == n)  # type: ignore[misc]

    def closing(totals: object) -> Manifest:
        close_manifest(manifest, anchor, totals)  # type: ignore[arg-type]
        return manifest

    writer.finish(closing)
    assert writer.wait(DEADLINE_S)
    assert writer.state == "finished", writer.error
    return manifest
