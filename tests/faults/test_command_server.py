"""What commands the robot is killed, frozen or cut off in the middle of a motion; and so is the bus itself.

How soon the robot holds is in `test_proof_control`: here it waits for its commander on a busy machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random, SystemRandom

import pytest

from station.control.gate import GateConfig
from tests.faults.control_trials import Kind, expect_safe, random_trial
from tests.faults.moving_station import MovingStation, stands_without_a_bus

PATIENT = GateConfig(hold_after_s=0.5, return_after_s=1.5)
SHORTLY_S = 1.5  # into the clip at most; `tests.faults.soak_control` waits longer and does it more often

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture(scope="module")
def station(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[MovingStation]:
    folder = tmp_path_factory.mktemp("moving")
    with MovingStation(folder, record=False, gate=PATIENT, physics_dt_s=0.002) as made:
        yield made


def went_to_stand(gates: Sequence[str]) -> bool:
    """Whether the gate held, returned and waits; a machine that stands still for a second makes no step to hold in."""
    left = [gate for gate in gates if gate not in ("entering", "tracking")]
    return left in (["holding", "returning", "waiting"], ["returning", "waiting"])


@pytest.mark.parametrize("kind", ["kill", "freeze", "cut"])
def test_the_robot_holds_returns_and_stands_and_follows_again(station: MovingStation, kind: Kind) -> None:
    seed = SystemRandom().randrange(10**6)
    trial = random_trial(station, kind, Random(seed), SHORTLY_S, enter_s=0.1)
    told = f"seed {seed}: {trial}"
    assert went_to_stand(trial.gates), told
    expect_safe(trial, PATIENT.hold_after_s, told)


def test_a_bus_that_is_killed_and_started_again_is_followed_again(station: MovingStation) -> None:
    seed = SystemRandom().randrange(10**6)
    trial = random_trial(station, "bus", Random(seed), SHORTLY_S, enter_s=0.1)
    told = f"seed {seed}: {trial}"
    assert trial.gates_after[-1] == "tracking", told
    assert trial.falls == 0, told


def test_where_the_bus_never_returns_the_robot_stands(tmp_path: Path) -> None:
    with MovingStation(tmp_path, record=False, gate=PATIENT, physics_dt_s=0.002) as station:
        assert went_to_stand(stands_without_a_bus(station))
