"""What a reader of captures returns: joints of a person as the file has them, in its own unit and world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adapters.retarget.human import SIDES
from station.errors import BadFile
from station.protocols import Floats

MOST_FRAMES = 1_000_000
"""No capture is longer: over two hours at 120 Hz."""

FASTEST_HZ, SLOWEST_HZ = 2000.0, 5.0
"""Rates at which people are captured [Hz]."""

PLACES = (
    "neck", "head",
    *(f"{side}_{name}" for name in ("hip", "knee", "ankle", "ball", "shoulder", "elbow", "wrist") for side in SIDES),
)  # fmt: skip
"""Joints whose places a reader finds; `ball` is that of the foot."""

TURNS = ("pelvis", "chest", *(f"{side}_{name}" for name in ("foot", "hand") for side in SIDES))
"""Parts whose orientations a reader finds."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Joints:
    """A person in n frames.

    Attributes:
        path: The file.
        fps: Frames per second.
        places: By each name of `PLACES`, shape (n, 3), in the file's unit and world.
        turns: By each name of `TURNS`, shape (n, 3, 3): its columns are what is forward, left and up of that part when
            the person stands in a T-pose with palms down, in the file's world, which is right-handed.
        unit_m: The file's unit, one of `adapters.captures.captured.UNITS_M` [m]; None where it does not say.
        height_m: How tall the person is, where a reader had to assume it [m].
        notes: What was guessed, filled or left out, for the user.
    """

    path: Path
    fps: float
    places: Mapping[str, Floats]
    turns: Mapping[str, Floats]
    unit_m: float | None = None
    height_m: float | None = None
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if missing := [name for name in PLACES if name not in self.places]:
            raise BadFile(f"{self.path}: the place of {missing[0]} is not in it; expected {', '.join(PLACES)}")
        count = len(self.places["head"])
        if not 2 <= count <= MOST_FRAMES:
            raise BadFile(f"{self.path}: {count} frames; expected 2 to {MOST_FRAMES}")
        if not SLOWEST_HZ <= self.fps <= FASTEST_HZ:
            raise BadFile(f"{self.path}: {self.fps:g} frames per second; expected {SLOWEST_HZ:g} to {FASTEST_HZ:g}")
        for name, values in (*self.places.items(), *self.turns.items()):
            bad = ~np.isfinite(values).reshape(count, -1).all(axis=1)
            if bad.any():
                raise BadFile(f"{self.path}: {name} is not finite in frame {int(bad.argmax())} of {count}")
