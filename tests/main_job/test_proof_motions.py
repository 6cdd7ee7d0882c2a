"""Every motion that TWIST2 ships, and Holosoma's dance, drive the simulated G1 through the real processes; what is
asked of each run is in `test_motions`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.figures import Figures
from tests.main_job.test_motions import (  # noqa: F401  tests of each run
    SHIPPED,
    UPSTREAM,
    Case,
    Driven,
    Runs,
    driving,
    test_joints_follow_the_motion,
    test_motion_runs_to_its_end_without_a_fall,
    test_nothing_is_lost_and_the_episode_is_good,
    test_policy_gives_the_recorded_actions_again_bit_for_bit,
    test_recorded_commands_move_a_fresh_simulation_alike,
    test_rehearsal_gives_the_same_figures,
)

pytestmark = [pytest.mark.timeout(600), pytest.mark.assets]

DANCES = {"fastsac": 0.14, "ppo": 0.10}
"""Holosoma's trackers, each with the clip in its own file, and the mean joint error that it may have [rad]."""
FILES = {name: f"zoo:policies/holosoma_wbt_{name}_g1_29dof_dancing.onnx" for name in DANCES}
CASES = [
    *(case for case in (*map(Case, SHIPPED), Case(SHIPPED[0], "twist2")) if case not in UPSTREAM),
    *(Case(FILES[name], "holosoma-wbt", FILES[name], error_rad) for name, error_rad in DANCES.items()),
]


@pytest.fixture(scope="module")
def runs(processes: None, proof: Figures, assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runs]:
    assert assets
    with driving(CASES, tmp_path_factory) as found:
        yield found


@pytest.fixture(params=CASES, ids=str)
def run(request: pytest.FixtureRequest, runs: Runs) -> Driven:
    """The run of one case."""
    return runs[request.param].result()


def test_the_verdict_is_good(run: Driven, proof: Figures) -> None:
    assert run.check["verdict"] == "good", run.check["reasons"]
