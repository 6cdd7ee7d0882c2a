"""A robot that loses its commander while it walks comes to a stand within half a metre."""

from __future__ import annotations

import pytest

from station import registry
from station.control.rig import build
from tests.suite.lost_walk import lose
from tests.suite.made import TRACKER


@pytest.mark.parametrize("at_s", [5.0, 5.5])
def test_commands_that_are_lost_at_a_fast_walk_take_it_no_further_than_45_cm(at_s: float) -> None:
    lost = lose(build(TRACKER), registry.find("loader", "motion")("builtin:walk-fast"), at_s)
    assert not lost.fell
    assert 0.84 < lost.speed_mps < 1.0
    assert lost.farthest_m < 0.45, "0.66 and 0.82 m where velocities are blended with the pose"
