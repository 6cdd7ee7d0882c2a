"""Episodes with depth beside colour, whose depth pictures are chosen one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from station import depth
from station.bus import keys
from tests.episode.scenes import CAMERA_HZ, HEAD, LENGTH_S, STATE_HZ, Film, Shot
from tests.episode.synthetic import STANDING, EpisodeBuilder, tick

DEPTH = keys.camera_depth("head")
SERVER: dict[str, Any] = {
    "role": "sensor", "key": HEAD, "camera": "head", "fps": CAMERA_HZ, "width": 320, "height": 240,
    "depth": {"key": DEPTH, "step_m": 0.001, "range_m": [0.1, 10.0], "is_aligned": True},
}  # fmt: skip
"""As a camera server states itself that gives depth."""


def steps(number: int, *, width: int = 80, height: int = 60) -> depth.Steps:
    """A floor with a box that comes nearer, in millimetres, and a stripe without depth; every number differs."""
    found = np.tile(np.linspace(1000, 6000, height)[:, None], (1, width)).astype(np.uint16)
    found[20:40, 30:50] = 900 - number
    found[:, :4] = 0
    return found


def measured(shot: Shot) -> bytes:
    return depth.encoded(steps(shot.number))


def filmed(data: Path, film: Film = measured, *, colour: Film | None = None) -> Path:
    """Record a robot that moves an arm before a camera with depth, perhaps with colour; return the folder.

    A film gives b"" for a picture that is not written.
    """
    builder = EpisodeBuilder(data)
    times = [(n / STATE_HZ, 0, n) for n in range(round(LENGTH_S * STATE_HZ))]
    times += [(n / CAMERA_HZ, 1, n) for n in range(round(LENGTH_S * CAMERA_HZ))]
    for at_s, is_picture, count in sorted(times):
        if is_picture:
            shot = Shot(count)
            shown = {} if colour is None else {HEAD: colour(shot)}
            shown = {key: data for key, data in {**shown, DEPTH: film(shot)}.items() if data}
            builder.write(shown, at_s=at_s, writer="head")
        else:
            q = STANDING.copy()
            q[18] += 0.4 * np.sin(np.pi * at_s)
            tick(builder, count, at_s=at_s, q=q)
    servers = {"head": SERVER if colour is not None else {**SERVER, "key": DEPTH}}
    return builder.finish({"timing": {"duration_s": LENGTH_S}, "servers": servers})
