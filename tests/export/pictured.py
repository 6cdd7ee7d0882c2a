"""Episodes with a camera whose every picture carries its number, so that alignment can be read from decoded pixels."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from station import depth
from station.bus import codec, keys
from station.bus.stamp import Stamp, boot_id
from station.export.kind import Source
from station.protocols import Floats
from tests.episode.synthetic import (
    MONO_START_NS,
    ROBOT,
    STANDING,
    WALL_START_NS,
    EpisodeBuilder,
    command,
    tick,
)

HEAD, DEPTH = keys.camera_image("head"), keys.camera_depth("head")
_BITS, _CELL = 10, 16
OPTICS: dict[str, Any] = {
    "intrinsics": {"width": 160, "height": 96, "fx": 100.0, "fy": 101.0, "cx": 79.5, "cy": 47.5,
                   "distortion": "none", "coefficients": [], "source": ""},
    "mount": {"parent": "torso_link", "position_m": [0.1, 0.0, 0.2], "quat_wxyz": [0.5, -0.5, 0.5, -0.5]},
}  # fmt: skip
"""As a camera server states it."""


def jpeg(number: int, *, width: int = 160, height: int = 96) -> bytes:
    """A picture that shows a number as black and white cells."""
    picture = np.full((height, width, 3), 90, dtype=np.uint8)
    for bit in range(_BITS):
        picture[16:48, bit * _CELL : (bit + 1) * _CELL] = 255 if number >> bit & 1 else 0
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=90)
    return stream.getvalue()


def depth_steps(number: int) -> depth.Steps:
    """Depth that shows a number: 1000 mm and so many more, with a row without depth; odd sides."""
    steps = np.full((47, 81), 1000 + number, dtype=np.uint16)
    steps[0] = 0
    return steps


def number_in(rgb: Any) -> int:
    """The number that a decoded picture shows, shape (height, width, 3)."""
    pixels = np.asarray(rgb, dtype=float)[24:40].mean(axis=(0, 2))
    return sum(1 << bit for bit in range(_BITS) if pixels[bit * _CELL + 4 : (bit + 1) * _CELL - 4].mean() > 128)


def shoot(
    builder: EpisodeBuilder,
    number: int,
    *,
    at_s: float,
    lag_s: float = 0.02,
    data: bytes | None = None,
    key: str = HEAD,
) -> None:
    """One picture, taken at a time and written a little later, as a camera server does."""
    source = f"camera.7.{boot_id()}.cafe"
    value = jpeg(number) if data is None else data
    sequence = builder.skip(key, writer="camera")
    channel = builder._channel(key, source, "camera", value)
    taken = MONO_START_NS + round(at_s * 1e9)
    mark = Stamp(sequence, taken + round(lag_s * 1e9), WALL_START_NS, source, taken)
    builder._stamps.append(b"%d %s" % (channel, mark.encode()))
    builder._add(channel, value, at_s + lag_s, at_s + lag_s, sequence)


def pose(number: int) -> Floats:
    """Joints that say which step they are of."""
    q = STANDING.copy()
    q[0] = number / 1000
    return q


def walked(
    data: Path, number: int = 1, *, seconds: float = 2.0, camera_hz: float = 30.0, jitter_s: float = 0.0,
    task: str = "walk", manifest: dict[str, Any] | None = None, bad_pictures: tuple[int, ...] = (),
    has_depth: bool = False,
) -> Source:  # fmt: skip
    """Record a walk: step k has joint 0 at k/1000, asks for 0.5 + k/1000; picture k carries k, its depth too."""
    builder = EpisodeBuilder(data, task=task, number=number)
    rng = np.random.default_rng(number)
    step_events: list[tuple[float, int, int]] = [(0.1 + k / 50, 0, k) for k in range(round(seconds * 50))]
    if camera_hz:
        step_events += [(0.083 + k / camera_hz, 1, k) for k in range(round(seconds * camera_hz))]
    for at_s, is_picture, k in sorted(step_events):
        if is_picture:
            bad = b"no picture" if k in bad_pictures else None
            shoot(builder, k, at_s=at_s, data=bad)
            if has_depth:
                shoot(builder, k, at_s=at_s, data=bad or depth.encoded(depth_steps(k)), key=DEPTH)
        else:
            asked = command(pose(500 + k))
            tick(builder, k, at_s=at_s + float(rng.uniform(-jitter_s, jitter_s)), q=pose(k), asked=asked)
    folder = builder.finish({"robot": {"suffix": ROBOT}, **(manifest or {})})
    return Source(episode_id=folder.name, folder=str(folder))


def numbers(values: Floats) -> bytes:
    """A vector as the bus holds it."""
    return codec.json_vector(values)
