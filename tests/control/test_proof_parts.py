"""A G1 walks by pedals while its arms are moved, whatever becomes of the commands of each, for ten minutes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.control.parted_walk import ASAP, FALCON, HOLOSOMA, RLGYM, walked
from tests.figures import Figures

SECONDS = 600.0

pytestmark = [
    pytest.mark.assets, pytest.mark.timeout(900), pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("legs", "checkpoint", "swing"),
    [
        pytest.param("rlgym-g1", RLGYM, 2.0, marks=pytest.mark.torch),
        ("holosoma", HOLOSOMA, 0.5),
        ("falcon", FALCON, 2.0),
        ("asap", ASAP, 2.0),
        ("g1-walk", "builtin:g1-walk.onnx", 1.0),
    ],
)
def test_pedals_and_arms_come_and_go_for_ten_minutes_and_it_walks_on(
    legs: str, checkpoint: str, swing: float, assets: Path, proof: Figures
) -> None:
    seen, way, before = set[tuple[int, str]](), 0.0, None
    for states, place in walked(legs, checkpoint, swing, SECONDS):
        seen.update(enumerate(states))
        if place is not None and before is not None:
            way += float(np.linalg.norm(place[:2] - before[:2]))
        before = place
    for part in range(3):
        assert {(part, state) for state in ("waiting", "entering", "tracking", "holding")} <= seen
    what = f"{legs} walks, arms sent as far as {0.6 * swing:g} rad, each part silent, late or wrong at random"
    proof.figure(what, way, "m in 10 min", limit="no fall")
