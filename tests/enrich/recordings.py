"""Small recordings with something of every kind in them."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.tap import Write
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import read_anchor
from station.episode.storage.manifest import Manifest
from tests.episode.synthetic import EpisodeBuilder, walk
from tests.episode.writes import Native
from tests.waiting import DEADLINE_S

POSE = [0.1, -0.2, 1.6, 0.5, 0.5, -0.5, 0.5]
FALL_S = 0.7


def walked(data: Path, *, seconds: float = 1.0, number: int = 1) -> Path:
    """A walk with an operator who looks on, a fall, a stranger's key and a key that was deleted; return its folder."""
    builder = EpisodeBuilder(data, number=number)
    walk(builder, seconds=seconds)
    builder.event("fall", at_s=FALL_S, severity="error", lean_rad=1.25)
    hand = np.tile(POSE, 26)
    builder.write(
        {
            keys.operator_head("pico"): codec.f64(POSE),
            keys.operator_hand_left("pico"): codec.f64(hand),
            keys.operator_controls("pico"): b'{"left_trigger": 0.5, "left_primary": 1}',
            keys.operator_joints("gello"): codec.f64([0.0] * 7),
        },
        at_s=FALL_S,
        writer="pico",
    )
    builder.foreign("strange", b"[1, 2]", at_s=FALL_S)
    builder.delete(twist_keys.action_body(), at_s=FALL_S)
    return builder.finish()


def jpeg(number: int) -> bytes:
    """A picture whose brightness is its number."""
    file = BytesIO()
    Image.new("RGB", (16, 8), (number, number, number)).save(file, "JPEG", quality=95)
    return file.getvalue()


def filmed(
    folder: Path, pictures: list[bytes], capture_ns: list[int | None], facts: dict[str, Any] | None = None
) -> Path:
    """A recording of a camera, whose server states some facts, by the real writer of episodes; return its folder."""
    folder.mkdir(parents=True)
    camera, key = Native("camera"), keys.camera_image("head")
    writes: list[Write] = [
        camera.write(key, picture, capture_ns=taken) for picture, taken in zip(pictures, capture_ns, strict=True)
    ]
    writer = EpisodeWriter(folder, anchor=read_anchor(), manifest=Manifest(episode_id=folder.name))
    writer.put(writes)
    stated = {"camera": {"key": key, "width": 16, "height": 8, **(facts or {})}}
    writer.finish(
        lambda totals: Manifest(episode_id=folder.name, state="finished", streams=totals.streams, servers=stated)
    )
    assert writer.wait(DEADLINE_S)
    return folder
