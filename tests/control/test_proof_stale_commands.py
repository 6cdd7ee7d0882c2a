"""Nothing that is too old by either clock moves a joint: many more cases than a test of every day plays."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings

from tests.control.test_stale_commands import SCENES, expect_nothing_stale_moves


@settings(max_examples=20_000, deadline=None, suppress_health_check=list(HealthCheck))
@given(*SCENES)
def play_many(steady: list[tuple[int, int, float]], messages: list[tuple[int, str, float | int, float]]) -> None:
    expect_nothing_stale_moves(steady, messages)


@pytest.mark.timeout(3600)
def test_nothing_stale_moves_a_joint_in_twenty_thousand_cases(proof: None) -> None:
    play_many()
