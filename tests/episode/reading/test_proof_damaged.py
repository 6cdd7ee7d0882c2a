"""Thousands of damaged episodes go through everything that reads one."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.episode.reading.test_hostile_files import (
    Files,
    _flipped,
    _rewritten,
    put,
    read_everything,
    whole,
)
from tests.figures import Figures

__all__ = ["put", "whole"]  # fixtures

EACH = 1500
pytestmark = [pytest.mark.timeout(3600), pytest.mark.filterwarnings("error::RuntimeWarning")]

Damage = Callable[[Files, random.Random], Files]


def _flips(drawn: random.Random, most: int) -> list[tuple[float, int]]:
    return [(drawn.random(), drawn.randrange(1, 256)) for _ in range(drawn.randrange(1, most + 1))]


DAMAGES: dict[str, Damage] = {
    "flipped bytes anywhere": lambda files, drawn: Files(_flipped(files.signals, _flips(drawn, 20)), files.manifest),
    "flipped bytes where the structure is": lambda files, drawn: Files(
        _flipped(files.signals, _flips(drawn, 20), *drawn.choice([(0.0, 0.02), (0.9, 1.0)])), files.manifest
    ),
    "cut short": lambda files, drawn: Files(files.signals[: drawn.randrange(len(files.signals))], files.manifest),
    "a manifest with flipped bytes": lambda files, drawn: Files(
        files.signals, _flipped(files.manifest, _flips(drawn, 8))
    ),
}


@pytest.mark.parametrize("damage", [*DAMAGES, "damage that no checksum tells"])
def test_no_damaged_episode_ends_what_reads_it(
    proof: Figures, whole: Files, put: Callable[[bytes, bytes], Path], damage: str
) -> None:
    refused = 0
    for number in range(EACH):
        seed = f"{damage}/{number}"
        drawn = random.Random(seed)
        try:
            if damage in DAMAGES:
                folder = put(*DAMAGES[damage](whole, drawn))
            else:
                flips = _flips(drawn, 20)
                damaged = _rewritten(put(*whole), lambda body, flips=flips: _flipped(body, flips))  # type: ignore[misc]
                folder = put(damaged, whole.manifest)
            refused += read_everything(folder) > 0
        except Exception as error:
            raise AssertionError(f"random.Random({seed!r})") from error
    proof.figure(
        f"damaged episodes ({damage}) that ended `list`, `check`, `audit` or `show`", f"0 of {EACH}",
        limit="0",
    )  # fmt: skip
    assert refused < EACH, "else nothing was read"
