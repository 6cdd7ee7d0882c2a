"""Whatever is killed while an arm moves, the arm comes to rest; how soon is in `test_proof_kassow`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from station.control.gate import GateConfig
from tests.faults.arm_trials import kill, operated, write_through_a_frozen_bus

SILENCE = GateConfig(hold_after_s=0.5, return_after_s=2.0)
"""So long without a command counts as letting go: longer than a busy machine keeps a commander from writing."""

pytestmark = pytest.mark.usefixtures("processes")


@pytest.mark.parametrize("name", ["kassow", "teleop", "bus"])
def test_the_arm_comes_to_rest_after_a_kill(kord: Any, tmp_path: Path, name: str) -> None:
    with operated(kord, tmp_path) as arm:
        arm.ticks_to_rest(kill(arm, name))
        assert arm.controller.simulator.trace()["fault"].max() == 0


def test_who_goes_on_writing_through_a_frozen_bus_after_a_stop_is_not_followed_when_it_is_back(
    kord: Any, tmp_path: Path
) -> None:
    followed = write_through_a_frozen_bus(kord, tmp_path, frozen_s=4.0, gate=SILENCE)
    assert set(followed.gates) == {"waiting"}
