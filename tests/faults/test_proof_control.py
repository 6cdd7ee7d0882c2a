"""How soon the robot holds and stands when its commander, its bus or its own server is gone, over many trials."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from random import Random
from tempfile import mkdtemp

import pytest

from station.control.gate import GateConfig
from tests.faults.control_trials import KINDS, Kind, Trial, expect_safe, random_trial
from tests.faults.moving_station import MovingStation, stands_without_a_bus
from tests.faults.soak_control import figures
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time

GATE = GateConfig()
HOLDS_S = GATE.return_after_s - GATE.hold_after_s
TRIALS = {"kill": 20, "freeze": 20, "cut": 20, "bus": 10, "g1": 10}
SEED = 1
TITLES = {
    "kill": "command server `kill -9`", "freeze": "command server frozen", "cut": "its connection cut",
    "bus": "bus `kill -9`, away up to 4 s", "g1": "G1 server `kill -9`, away up to 2 s",
}  # fmt: skip
FIGURES = (
    ("fault_to_hold_ms", "fault to hold", "ms", ""),
    ("age_at_hold_ms", "age of the command at hold", "ms", ""),
    ("last_command_to_standing_s", "last good command to standing", "s", ""),
    ("end_of_fault_to_following_s", "end of fault to following", "s", ""),
    ("followed_age_max_ms", "oldest command that was followed", "ms", "100 ms"),
)


def expect_held(gates: Sequence[str], waits: Waits, told: str) -> None:
    """It held, returned and stands; or no step was made soon enough to hold, because a process had to wait."""
    if tuple(gates[-3:]) == ("tracking", "returning", "waiting"):
        raise TooLate(f"a step that holds; {told}", HOLDS_S, waits.longest_s)
    assert tuple(gates[-3:]) == ("holding", "returning", "waiting"), told


@pytest.mark.timeout(1500)
@pytest.mark.parametrize("kind", KINDS)
def test_at_random_moments_of_random_clips_the_robot_holds_at_once_and_never_falls(
    kind: Kind, tmp_path: Path, processes: None, proof: Figures
) -> None:
    random, trials = Random(f"{SEED} {kind}"), []
    with MovingStation(tmp_path, record=False) as station:
        for _ in range(TRIALS[kind]):
            trials.append(in_time(lambda: one_trial(station, kind, random)))
    found = figures(kind, trials)
    proof.figure(f"{TITLES[kind]}: falls in {found['runs']} runs", found["falls"], limit="0")
    proof.figure(f"{TITLES[kind]}: worst lean", float(found["worst_lean_deg"]), "deg")
    for name, what, unit, limit in FIGURES:
        if name in found:
            spread = found[name]
            both = f"{spread['p50']:.3g} / {spread['max']:.3g}"
            proof.figure(f"{TITLES[kind]}: {what}, p50 / max", both, unit, limit)


def one_trial(station: MovingStation, kind: Kind, random: Random) -> Trial:
    with Waits.watched() as waits:
        trial = random_trial(station, kind, random)
    if kind in ("bus", "g1"):
        assert trial.gates_after[-1] == "tracking", f"{trial}"
        assert trial.falls == 0, f"{trial}"
    else:
        expect_safe(trial, GATE.hold_after_s, f"{trial}")
        expect_held(trial.gates, waits, f"{trial}")
    return trial


def test_where_the_bus_never_returns_the_robot_holds_at_once_and_stands(
    tmp_path: Path, processes: None, proof: Figures
) -> None:
    def lose_the_bus() -> None:
        with (
            Waits.watched() as waits,
            MovingStation(Path(mkdtemp(dir=tmp_path)), record=False) as station,
        ):
            gates = stands_without_a_bus(station)
        expect_held(gates, waits, f"{gates}")

    in_time(lose_the_bus)
