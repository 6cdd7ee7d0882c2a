"""Motions drive the simulated G1 through the real processes, in lock-step, and what each run left behind is sound.

The built-in walk and squat run without upstream data, also where there is some: this is what a user gets who has
installed the station and nothing else. The shortest motion that TWIST2 ships runs with TWIST2's policy;
`test_proof_motions` has all of them with both, and `tests/test_rehearse.py` without processes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from station.assets import ENVIRONMENT_VARIABLE
from station.control.rig import robot_kind
from tests.main_job.station_runs import LOCK_STEP, Terminal, up
from tests.verdicts import OF_A_LATE_MACHINE

SIDE_BY_SIDE = 2
MOST_JOINT_ERROR_RAD = 0.10
SAME = 0.01  # a rehearsal and a run through the processes
BLENDS_S = 4.0  # into the motion and out of it, more than it takes

pytestmark = pytest.mark.timeout(300)


DEFAULT_POLICY = robot_kind("").policy


class Case(NamedTuple):
    """A motion and the policy that does it, a checkpoint where it has none of its own, and how well it does."""

    motion: str
    policy: str = DEFAULT_POLICY
    checkpoint: str = ""
    most_error_rad: float = MOST_JOINT_ERROR_RAD

    @property
    def is_built_in(self) -> bool:
        return self.motion.startswith("builtin:")

    def __str__(self) -> str:
        return f"{self.policy}-{Path(self.motion).stem}"


SHIPPED = [f"twist2:motions/0807_yanjie_walk_{number:03}.pkl" for number in range(1, 7)]
BUILT_IN = [Case("builtin:walk-forward"), Case("builtin:squat")]
UPSTREAM = [Case(SHIPPED[3], "twist2")]


class Driven(NamedTuple):
    """One motion, from the runbook to the replay and, for comparison, offline."""

    case: Case
    output: str
    check: dict[str, Any]
    audit: dict[str, Any]
    replay: dict[str, Any]
    rehearsal: dict[str, Any]

    @property
    def steps(self) -> dict[str, Any]:
        """What the check says of the policy steps of the only robot."""
        (robot,) = self.check["steps"]
        return dict(robot)


Runs = dict[Case, Future[Driven]]


@pytest.fixture(scope="module")
def built_in(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runs]:
    with driving(BUILT_IN, tmp_path_factory) as runs:
        yield runs


@pytest.fixture(scope="module")
def upstream(processes: None, assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runs]:
    assert assets
    with driving(UPSTREAM, tmp_path_factory) as runs:
        yield runs


@pytest.fixture(params=[*BUILT_IN, *(pytest.param(case, marks=pytest.mark.assets) for case in UPSTREAM)], ids=str)
def run(processes: None, request: pytest.FixtureRequest) -> Driven:
    """The run of one case; a test waits for its own only."""
    runs: Runs = request.getfixturevalue("built_in" if request.param.is_built_in else "upstream")
    return runs[request.param].result()


@contextmanager
def driving(cases: Sequence[Case], folders: pytest.TempPathFactory) -> Iterator[Runs]:
    """Run cases, two stations at a time, each on its own bus."""
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        runs = {case: pool.submit(drive, case, folders.mktemp("station")) for case in cases}
        yield runs
        for run in runs.values():
            run.cancel()


def drive(case: Case, folder: Path) -> Driven:
    terminal = Terminal(folder)
    if case.is_built_in:
        terminal.environment.pop(ENVIRONMENT_VARIABLE, None)
    # What is the default is not said: the runbook and the station must agree on it.
    policy = [] if case.policy == DEFAULT_POLICY else [f"g1.policy={case.policy}"]
    checkpoint = [f"g1.checkpoint={case.checkpoint}"] if case.checkpoint else []
    done = terminal.run(*up("walk", *LOCK_STEP, *policy, *checkpoint, f"motion.motion={case.motion}"))
    output = done.stdout + done.stderr
    assert done.returncode == 0, output
    episode = str(terminal.episode("walk"))
    named = ["--checkpoint", case.checkpoint] if case.checkpoint else []
    (rehearsal,) = terminal.json("rehearse", case.motion, "--policy", case.policy, *named)["motions"]
    return Driven(
        case=case,
        output=output,
        check=terminal.json("check", episode),
        audit=terminal.json("audit", episode),
        replay=terminal.json("replay", episode, "--to", "sim"),
        rehearsal=rehearsal,
    )


def test_motion_runs_to_its_end_without_a_fall(run: Driven) -> None:
    assert run.check["events"]["motion-end"] == 1, run.output
    assert "is_complete=True" in run.output
    assert (run.check["falls"], run.check["resets"], run.check["estops"]) == (0, 0, 0)
    # Lock-step: what is not the blend into the first command is tracking, and not one tick was interrupted.
    assert set(run.steps["gate_shares"]) == {"entering", "tracking"}
    assert run.steps["interrupted_share"] == 0.0


def test_joints_follow_the_motion(run: Driven) -> None:
    assert run.steps["compared_steps"] * 0.02 > run.rehearsal["seconds"] - BLENDS_S
    assert run.steps["mean_joint_error_rad"] <= run.case.most_error_rad


def test_nothing_is_lost_and_the_episode_is_good(run: Driven) -> None:
    check = run.check
    assert {stream["key"]: stream["lost"] for stream in check["streams"] if stream["lost"]} == {}
    assert (check["dropped"], check["holes"], check["recorder_restarts"]) == (0, 0, 0)
    assert (check["is_lossless"], check["is_finished"], check["torn"]) == (True, True, None)
    assert {reason["rule"] for reason in check["reasons"]} <= OF_A_LATE_MACHINE, check["reasons"]


def test_policy_gives_the_recorded_actions_again_bit_for_bit(run: Driven) -> None:
    assert run.audit["steps"] == run.steps["steps"]
    assert (run.audit["different"], run.audit["observations"]["different"], run.audit["incomplete"]) == (0, 0, 0)
    assert run.audit["sha256"] == run.audit["recorded_sha256"]


def test_recorded_commands_move_a_fresh_simulation_alike(run: Driven) -> None:
    assert run.replay["lock_step"]
    assert (run.replay["steps"] + run.replay["without_state"], run.replay["different"]) == (run.steps["steps"], 0)
    assert run.replay["without_state"] <= 1, "a bus that is slow for seconds costs the first state"
    assert (run.replay["gates_different"], run.replay["max_q_difference_rad"]) == (0, 0.0)
    assert not run.replay["fell"]


def test_rehearsal_gives_the_same_figures(run: Driven) -> None:
    assert not run.rehearsal["fell"]
    for name in ("mean_joint_error_rad", "mean_root_height_error_m"):
        assert math.isclose(run.rehearsal[name], run.steps[name], rel_tol=SAME), name


@pytest.mark.assets
def test_all_shipped_motions_are_tried(assets: Path) -> None:
    assert sorted(f"twist2:motions/{path.name}" for path in (assets / "twist2/motions").iterdir()) == SHIPPED
