"""Long runs in which things go wrong: an operator of each device, and a whole station under load."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from tests.faults import soak_operator
from tests.faults.control_trials import CLIPS
from tests.faults.moving_station import MovingStation
from tests.faults.operator_scripts import SESSIONS
from tests.faults.soak import Soak
from tests.figures import Figures

OPERATOR_MIN, STATION_MIN = 2.0, 4.0
LOAD = {"per_s": 10_000.0, "mb_per_s": 30.0}
EVERY_S = 10.0


@pytest.mark.timeout(600)
@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("device", SESSIONS)
def test_an_operator_drives_through_losses_of_its_signal_and_a_death_of_its_server(device: str, proof: Figures) -> None:
    found = soak_operator.soak(device, OPERATOR_MIN)
    assert soak_operator.is_sound(found), found
    proof.figure(f"operator, {device}: engaged", f"{found['engaged']} of {found['cycles']}")
    proof.figure(f"operator, {device}: largest jump at engaging", float(found["largest_jump_at_engaging"]), limit="0")
    proof.figure(f"operator, {device}: worst lean", float(found["worst_lean_deg"]), "deg")
    proof.figure(f"operator, {device}: falls", found["falls"], limit="0")
    proof.figure(f"operator, {device}: verdict", found["verdict"])


@pytest.mark.timeout(1200)
@pytest.mark.usefixtures("processes")
def test_a_whole_station_under_load_loses_nothing_without_saying_so(tmp_path: Path, proof: Figures) -> None:
    with MovingStation(tmp_path) as station:
        soak = Soak(station, seed=1, every_s=EVERY_S, load=LOAD, kept=tmp_path / "kept")
        station.play(soak.random.choice(CLIPS))
        end_s = time.monotonic() + 60.0 * STATION_MIN
        while time.monotonic() < end_s:
            soak.episode(60.0)
        found = soak.figures()
        assert not soak.has_failed, found
    proof.figure("whole station under load: faults, minutes", f"{sum(found['faults'].values())}, {STATION_MIN:g}")
    proof.figure("whole station under load: falls", found["falls"], limit="0")
    proof.figure("whole station under load: writes", found["written"])
    proof.figure(
        "whole station under load: missing, unless told; twice",
        f"{found.get('lost', 0)}, {found['twice']}",
        limit="0, 0",
    )
