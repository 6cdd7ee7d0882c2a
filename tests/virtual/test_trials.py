"""Histories by seed: whatever happens to who commands, to lines, bus and robot, what must hold holds in every tick.

A trial with the same seed is the same to the last bit: `play(seed)` repeats what failed.
"""

from __future__ import annotations

import hashlib

import pytest

from tests.examples import some
from tests.virtual.trial import Trial, alone, play

EACH = 10


@pytest.mark.parametrize("first", some(range(0, 120, EACH)))
def test_no_history_breaks_what_must_hold_in_every_tick(first: int) -> None:
    for seed in range(first, first + EACH):
        play(seed, lasts_s=1.5)


def digest(seed: int) -> str:
    trial = Trial(seed, lasts_s=1.0)
    with alone():
        trial.play()
    done = [(tick.now_s, tick.state, tick.arming, tick.vector.tolist()) for tick in trial.robot.ticks]
    return hashlib.sha256(repr(done).encode()).hexdigest()


def test_a_seed_is_one_history() -> None:
    digests = [digest(seed) for seed in (1, 2, 3)]
    assert digests == [digest(seed) for seed in (1, 2, 3)]
    assert len(set(digests)) == 3
