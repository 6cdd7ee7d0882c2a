"""What the gate and its operator make of streams: entering, cuts, holding, returning, and coming back elsewhere.

The arithmetic of `station.control.gate` with its default times, drawn as whole rows instead of stepped.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adapters.commands.twist2 import FORMAT
from research.tracker.streams import DT_S, Stream
from station.protocols import Floats

BLEND_IN, HOLD, BLEND_OUT = round(1.0 / DT_S), round(0.3 / DT_S), round(2.0 / DT_S)

Draw = Callable[[], Stream]


def gated(draw: Draw, rng: np.random.Generator, steps: int) -> Floats:
    """Return what the gate lets through in an episode, shape (steps, 35).

    Args:
        draw: Gives the next stream.
        rng: Draws where streams begin, how long they last and how they end.
        steps: Length of the episode.
    """
    rows: list[Floats] = [_standing(int(rng.integers(1, 50)))]
    length = len(rows[0])
    while length < steps:
        part = _visit(draw, rng, rows[-1][-1], steps - length)
        rows.append(part)
        length += len(part)
    return np.concatenate(rows)[:steps]


def _visit(draw: Draw, rng: np.random.Generator, present: Floats, most: int) -> Floats:
    """Follow a stream from the present command on, in one of the ways in and out that there are."""
    stream = draw()
    first = 0 if rng.random() < 0.5 else int(rng.integers(max(1, len(stream) - BLEND_IN)))
    count = min(len(stream) - first, most, int(rng.integers(100, 700)))
    live = stream[first : first + max(count, 1)]
    # One stream in eight begins without a blend: a command server that changes its mind at once.
    way_in = live if rng.random() < 0.125 else _blended(present, live)
    return np.concatenate([way_in, _way_out(rng, way_in[-1])])


def _way_out(rng: np.random.Generator, last: Floats) -> Floats:
    chance = rng.random()
    if chance < 0.25:  # the next stream begins at once
        return last[None]
    if chance < 0.4:  # a gap too short for returning
        return np.tile(last, (int(rng.integers(5, HOLD)), 1))
    held = np.tile(last, (HOLD, 1))
    home = last + np.linspace(0, 1, BLEND_OUT)[:, None] * (FORMAT.default - last)
    if chance < 0.6:  # the commands come back while it returns
        return np.concatenate([held, home[: int(rng.integers(1, BLEND_OUT))]])
    return np.concatenate([held, home, _standing(int(rng.integers(1, 100)))])


def _blended(present: Floats, live: Floats) -> Floats:
    part = np.minimum(np.arange(len(live)) / BLEND_IN, 1.0)[:, None]
    return np.asarray(present + part * (live - present))


def _standing(steps: int) -> Floats:
    return np.tile(FORMAT.default, (steps, 1))
