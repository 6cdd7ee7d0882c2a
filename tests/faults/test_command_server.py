"""What commands the robot is killed, frozen or cut off in the middle of a motion; and so is the bus itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random, SystemRandom
from tempfile import mkdtemp

import pytest

from station.control.gate import GateConfig
from tests.faults.control_trials import Kind, random_trial
from tests.faults.moving_station import MovingStation
from tests.lateness import TooLate, Waits, in_time
from tests.waiting import wait_until

GATE = GateConfig()
SHORTLY_S = 1.5  # into the clip at most; `tests.faults.soak_control` waits longer and does it more often


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MovingStation]:
    with MovingStation(tmp_path_factory.mktemp("moving"), record=False) as made:
        yield made


@pytest.mark.parametrize("kind", ["kill", "freeze", "cut"])
def test_the_robot_holds_returns_and_stands_and_follows_again(station: MovingStation, kind: Kind) -> None:
    in_time(lambda: lose_the_command(station, kind))


def lose_the_command(station: MovingStation, kind: Kind) -> None:
    seed = SystemRandom().randrange(10**6)
    with Waits.watched() as waits:
        trial = random_trial(station, kind, Random(seed), SHORTLY_S)
    told = f"seed {seed}: {trial}"
    assert trial.used_age_s <= GATE.hold_after_s + 1e-6, f"no older command is followed; {told}"
    expect_held(trial.gates, waits, told)
    assert trial.stands, f"back at standing it is asked to stand; {told}"
    assert trial.gates_after[-2:] == ("entering", "tracking"), f"another takes over with the blend; {told}"
    assert trial.rate <= 1.05, f"the command is continuous; {told}"
    assert trial.falls == 0, told


def expect_held(gates: Sequence[str], waits: Waits, told: str) -> None:
    """It held, returned and stands; or no step was made soon enough to hold, because somebody had to wait."""
    if tuple(gates[-3:]) == ("tracking", "returning", "waiting"):
        raise TooLate(f"a step that holds; {told}", GATE.return_after_s - GATE.hold_after_s, waits.longest_s)
    assert tuple(gates[-3:]) == ("holding", "returning", "waiting"), told


def test_a_bus_that_is_killed_and_started_again_is_followed_again(station: MovingStation) -> None:
    seed = SystemRandom().randrange(10**6)
    trial = random_trial(station, "bus", Random(seed), SHORTLY_S)
    told = f"seed {seed}: {trial}"
    assert trial.gates_after[-1] == "tracking", told
    assert trial.falls == 0, told


def test_where_the_bus_never_returns_the_robot_stands(tmp_path: Path) -> None:
    in_time(lambda: lose_the_bus_for_good(Path(mkdtemp(dir=tmp_path))))


def lose_the_bus_for_good(folder: Path) -> None:
    with Waits.watched() as waits, MovingStation(folder, record=False) as station:
        station.play("builtin:walk-forward")
        station.wait_s(1.0)
        station.kill_bus()
        # Nobody can hear it now; its log tells, and it counts its falls.
        wait_until(lambda: "from=returning to=waiting" in station.log("g1"))
        gates = [line.partition("gate ")[2].split()[1] for line in station.log("g1").splitlines() if " gate " in line]
        waits.seconds()
        expect_held(tuple(gate.removeprefix("to=") for gate in gates), waits, f"{gates}")
        station.start_bus()  # to ask how it stands
        wait_until(lambda: (health := station.health("g1")) is not None and health.detail.get("gate") is not None)
        station.wait_s(0.5)
        health = station.health("g1")
        assert health is not None
        assert health.detail["falls"] == 0
        assert station.is_upright()
