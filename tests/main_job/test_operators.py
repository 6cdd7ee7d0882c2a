"""The runbook of each device as a user runs it without hardware: a fake under the real library drives the G1."""

from __future__ import annotations

from pathlib import Path

import pytest

from station import assets
from tests.cli.running import Home
from tests.main_job.device_runs import SCRIPTS, drive, tracked
from tests.main_job.station_runs import ROOT as HOUSE
from tests.verdicts import expect_no_worse_but_late

TRACKED = 25  # steps
PATIENT = ("hold_after_s=5.0", "return_after_s=20.0", "blend_in_s=0.2")
"""A robot that does not leave its operator because a busy machine is late with a command."""

pytestmark = pytest.mark.timeout(240)


@pytest.mark.parametrize("device", SCRIPTS)
def test_fake_operator_drives_the_robot_and_leaves_a_sound_episode(
    device: str, tmp_path: Path, processes: None
) -> None:
    check = drive(device, Home(tmp_path), lambda log: tracked(log) >= TRACKED, *PATIENT)
    (robot,) = check.steps
    assert robot.gate_shares["tracking"] > 0
    expect_no_worse_but_late("usable", check)


@pytest.mark.parametrize("device", SCRIPTS)
def test_runbook_names_the_fake_that_it_is_tried_with(device: str) -> None:
    text = (HOUSE / "runbooks" / f"g1-sim-{device}.yaml").read_text(encoding="utf-8")
    for server, file in SCRIPTS[device].items():
        assert f"--set {server}.fake={file}" in text
        assert assets.resolve(file).is_file()
