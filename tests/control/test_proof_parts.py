"""A G1 walks by pedals while arms and hands are moved, whatever becomes of the commands of each, for ten minutes."""

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
    ("legs", "checkpoint", "swing", "hands"),
    [
        pytest.param("rlgym-g1", RLGYM, 2.0, False, marks=pytest.mark.torch),
        ("holosoma", HOLOSOMA, 0.5, False),
        ("falcon", FALCON, 2.0, False),
        ("asap", ASAP, 2.0, False),
        ("g1-walk", "builtin:g1-walk.onnx", 1.0, False),
        pytest.param("rlgym-g1", RLGYM, 1.0, True, marks=pytest.mark.torch),
        ("falcon", FALCON, 2.0, True),
        ("asap", ASAP, 2.0, True),
        ("g1-walk", "builtin:g1-walk.onnx", 1.0, True),
    ],
)
def test_pedals_arms_and_hands_come_and_go_for_ten_minutes_and_it_walks_on(
    legs: str, checkpoint: str, swing: float, hands: bool, assets: Path, proof: Figures
) -> None:
    seen, way, before = set[tuple[int, str]](), 0.0, None
    for states, place in walked(legs, checkpoint, swing, SECONDS, hands=hands):
        seen.update(enumerate(states))
        if place is not None and before is not None:
            way += float(np.linalg.norm(place[:2] - before[:2]))
        before = place
    for part in range(5 if hands else 3):
        assert {(part, state) for state in ("waiting", "entering", "tracking", "holding")} <= seen
    arms = f"arms sent as far as {0.6 * swing:g} rad{' and hands' if hands else ''}"
    what = f"{legs} walks, {arms}, each part silent, late or wrong at random"
    proof.figure(what, way, "m in 10 min", limit="no fall")
