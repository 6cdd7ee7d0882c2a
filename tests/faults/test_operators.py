"""Plans of an operator's long session with what goes wrong in it; `test_proof_soaks` runs one for each device."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.supervision.runbook import load
from tests.faults.operator_scripts import SESSIONS, Plan
from tests.main_job.station_runs import ROOT

SHORT_MIN = 0.6


@pytest.mark.parametrize("runbook", sorted((ROOT / "runbooks").glob("*-sim-*.yaml")), ids=lambda path: path.stem)
def test_device_server_that_dies_is_started_again(runbook: Path) -> None:
    devices = [step for step in load(runbook).servers if step.start in SESSIONS]
    assert [step.start for step in devices if step.if_it_dies != "restart"] == []


def test_plan_of_five_minutes_has_fifty_engagements_three_losses_and_a_death_in_cycles_of_their_own() -> None:
    plan = Plan.lasting(5.0)
    assert plan.cycles >= 50
    assert len({*plan.lossy, plan.fatal}) == 4
    assert plan.fatal < plan.cycles - 1


def test_in_the_short_session_too_somebody_drives_again_after_the_death() -> None:
    plan = Plan.lasting(SHORT_MIN)
    assert len({*plan.lossy, plan.fatal}) == 4
    assert plan.fatal < plan.cycles - 1
