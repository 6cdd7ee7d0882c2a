"""What commands the robot is killed, frozen or cut off in the middle of a motion; and so is the bus itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from random import Random, SystemRandom

import pytest

from station.control.gate import GateConfig
from tests.faults.control_trials import Kind, random_trial
from tests.faults.moving_station import MovingStation
from tests.waiting import wait_until

GATE = GateConfig()
SHORTLY_S = 1.5  # into the clip at most; `tests.faults.soak_control` waits longer and does it more often


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MovingStation]:
    with MovingStation(tmp_path_factory.mktemp("moving"), record=False) as made:
        yield made


@pytest.mark.parametrize("kind", ["kill", "freeze", "cut"])
def test_the_robot_holds_returns_and_stands_and_follows_again(station: MovingStation, kind: Kind) -> None:
    seed = SystemRandom().randrange(10**6)
    trial = random_trial(station, kind, Random(seed), SHORTLY_S)
    told = f"seed {seed}: {trial}"
    assert trial.used_age_s <= GATE.hold_after_s + 1e-6, f"no older command is followed; {told}"
    assert trial.gates[-3:] == ("holding", "returning", "waiting"), told
    assert trial.stands, f"back at standing it is asked to stand; {told}"
    assert trial.gates_after[-2:] == ("entering", "tracking"), f"another takes over with the blend; {told}"
    assert trial.rate <= 1.05, f"the command is continuous; {told}"
    assert trial.falls == 0, told


def test_a_bus_that_is_killed_and_started_again_is_followed_again(station: MovingStation) -> None:
    seed = SystemRandom().randrange(10**6)
    trial = random_trial(station, "bus", Random(seed), SHORTLY_S)
    told = f"seed {seed}: {trial}"
    assert trial.gates_after[-1] == "tracking", told
    assert trial.falls == 0, told


def test_where_the_bus_never_returns_the_robot_stands(tmp_path: Path) -> None:
    with MovingStation(tmp_path, record=False) as station:
        station.play("builtin:walk-forward")
        station.wait_s(1.0)
        station.kill_bus()
        # Nobody can hear it now; its log tells, and it counts its falls.
        wait_until(lambda: "from=returning to=waiting" in station.log("g1"))
        gates = [line.partition("gate ")[2].split()[:2] for line in station.log("g1").splitlines() if " gate " in line]
        assert gates[-3:] == [["from=tracking", "to=holding"], ["from=holding", "to=returning"],
                              ["from=returning", "to=waiting"]]  # fmt: skip
        station.start_bus()  # to ask how it stands
        wait_until(lambda: (health := station.health("g1")) is not None and health.detail.get("gate") is not None)
        station.wait_s(0.5)
        health = station.health("g1")
        assert health is not None
        assert health.detail["falls"] == 0
        assert station.is_upright()
