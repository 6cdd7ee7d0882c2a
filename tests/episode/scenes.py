"""Episodes of a robot that moves an arm before cameras, whose pictures are real JPEG files, chosen one by one."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from station.bus import keys
from station.protocols import Floats
from tests.episode.synthetic import STANDING, EpisodeBuilder, tick

HEAD, WRIST = keys.camera_image("head"), keys.camera_image("wrist")
LENGTH_S, CAMERA_HZ, STATE_HZ = 6.0, 15, 50
PICTURES = round(LENGTH_S * CAMERA_HZ)
SERVERS = {
    "head": {"role": "sensor", "key": HEAD, "camera": "head", "fps": CAMERA_HZ},
    "wrist": {"role": "sensor", "key": WRIST, "camera": "wrist", "fps": CAMERA_HZ},
}
_RNG = np.random.default_rng(3)
_NOISE = _RNG.normal(0.0, 4.0, (13, 240, 320))


def file_of(grey: Floats, *, quality: int = 90) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(grey.clip(0, 255).astype(np.uint8)).convert("RGB").save(stream, "JPEG", quality=quality)
    return stream.getvalue()


def scene(number: int, *, moves: bool = True) -> Floats:
    """Grey of a room with a box in it that moves, shape (240, 320), without noise."""
    grey = np.tile(np.linspace(60.0, 190.0, 320), (240, 1))
    grey[::24] -= 30.0
    at = 20 + (3 * number % 200 if moves else 0)
    grey[90:150, at : at + 60] = 230.0
    return grey


def noise(number: int) -> Floats:
    """Of a sensor: what differs from picture to picture where nothing moves, shape (240, 320)."""
    return _NOISE[number % len(_NOISE)]


def noisy(number: int, *, moves: bool = True, gain: float = 1.0) -> bytes:
    return file_of(gain * scene(number, moves=moves) + noise(number))


@dataclass
class Shot:
    """One picture of an episode: its number, and when it is taken [s]."""

    number: int
    at_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.at_s = self.number / CAMERA_HZ


Film = Callable[[Shot], bytes]


def sound(shot: Shot) -> bytes:
    return noisy(shot.number)


def filmed(
    data: Path, film: Film, *, moves: bool = True, wrist: Film | None = None, number: int = 1,
    length_s: float = LENGTH_S, **manifest: Any,
) -> Path:  # fmt: skip
    """Record a robot that moves an arm, or stands, with a camera, and return the folder of the episode."""
    builder = EpisodeBuilder(data, number=number)
    times = [(n / STATE_HZ, 0, n) for n in range(round(length_s * STATE_HZ))]
    times += [(n / CAMERA_HZ, 1, n) for n in range(round(length_s * CAMERA_HZ))]
    for at_s, is_picture, count in sorted(times):
        if is_picture:
            builder.write({HEAD: film(Shot(count))}, at_s=at_s, writer="head")
            if wrist is not None:
                builder.write({WRIST: wrist(Shot(count))}, at_s=at_s, writer="wrist")
        else:
            q = STANDING.copy()
            q[18] += 0.4 * np.sin(np.pi * at_s) if moves else 0.0
            tick(builder, count, at_s=at_s, q=q)
    servers = {name: facts for name, facts in SERVERS.items() if name == "head" or wrist is not None}
    return builder.finish({"timing": {"duration_s": length_s}, "servers": servers, **manifest})
