"""Over all walks and many moments: nothing falls, and how far a robot goes on without its commander."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from station import registry
from station.control.rig import build
from station.errors import AssetMissing
from station.suite.promise import UPSTREAM
from tests.suite.lost_walk import lose
from tests.suite.made import TRACKER

EVERY_S = 0.4
WALKS = (
    "march", "turn-left", "turn-right", "walk-arc", "walk-back", "walk-diagonal", "walk-fast", "walk-forward",
    "walk-left", "walk-right",
)  # fmt: skip


@pytest.mark.timeout(3600)
def test_no_walk_falls_when_its_commands_are_lost(proof: None, record_property: Callable[[str, object], None]) -> None:
    rig, load, lost = build(TRACKER), registry.find("loader", "motion"), []
    for clip in (*(f"builtin:{name}" for name in WALKS), *UPSTREAM):
        try:
            motion = load(clip)
        except AssetMissing:
            continue
        lost += [lose(rig, motion, at_s) for at_s in np.arange(0.65, motion.duration_s, EVERY_S).tolist()]
    fast = [one.farthest_m for one in lost if 0.8 <= one.speed_mps <= 1.0]
    figures = {"losses": len(lost), "fast": len(fast), "mean_m": float(np.mean(fast)), "farthest_m": float(max(fast))}
    for name, value in figures.items():
        record_property(name, value)
    assert not any(one.fell for one in lost)
    assert figures["mean_m"] < 0.5, figures
