"""Every shipped motion drives the simulated G1 through the real processes, in lock-step, and what it left is sound."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.main_job.station_runs import LOCK_STEP, Terminal, up

MOTIONS = tuple(f"twist2:motions/0807_yanjie_walk_{number:03}.pkl" for number in range(1, 7))
SIDE_BY_SIDE = 2
MOST_JOINT_ERROR_RAD = 0.11
SAME = 0.01  # a rehearsal and a run through the processes

pytestmark = [pytest.mark.assets, pytest.mark.timeout(300)]


@dataclass(frozen=True)
class Driven:
    """One motion, from the runbook to the replay."""

    exit_code: int
    output: str
    check: dict[str, Any]
    audit: dict[str, Any]
    replay: dict[str, Any]


@pytest.fixture(scope="module")
def driven(assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future[Driven]]]:
    """All motions, two stations at a time, each on its own bus; a test waits for its own only."""
    assert assets
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        runs = {motion: pool.submit(drive, motion, tmp_path_factory.mktemp("station")) for motion in MOTIONS}
        yield runs
        for run in runs.values():
            run.cancel()


@pytest.fixture(scope="module")
def rehearsed(driven: dict[str, Future[Driven]], tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What `station rehearse` says of all motions, by motion; after the runs, so as not to slow them."""
    for run in driven.values():
        run.result()
    found = Terminal(tmp_path_factory.mktemp("rehearsal")).json(
        "rehearse", "twist2:motions/*.pkl", "--policy", "twist2"
    )
    return {item["motion"]: item for item in found["motions"]}


def drive(motion: str, folder: Path) -> Driven:
    terminal = Terminal(folder)
    done = terminal.run(*up("walk", *LOCK_STEP, f"motion.motion={motion}"))
    output = done.stdout + done.stderr
    assert done.returncode == 0, output
    episode = str(terminal.episode("walk"))
    return Driven(
        exit_code=done.returncode,
        output=output,
        check=terminal.json("check", episode),
        audit=terminal.json("audit", episode),
        replay=terminal.json("replay", episode, "--to", "sim"),
    )


@pytest.mark.parametrize("motion", MOTIONS)
def test_motion_runs_to_its_end_without_a_fall(driven: dict[str, Future[Driven]], motion: str) -> None:
    run = driven[motion].result()
    assert run.check["events"]["motion-end"] == 1, run.output
    assert "is_complete=True" in run.output
    assert (run.check["falls"], run.check["resets"], run.check["estops"]) == (0, 0, 0)
    (robot,) = run.check["steps"]
    # Lock-step: what is not the blend into the first command is tracking, and not one tick was interrupted.
    assert set(robot["gate_shares"]) == {"entering", "tracking"}
    assert robot["interrupted_share"] == 0.0


@pytest.mark.parametrize("motion", MOTIONS)
def test_joints_follow_the_motion(driven: dict[str, Future[Driven]], motion: str) -> None:
    (robot,) = driven[motion].result().check["steps"]
    assert robot["compared_steps"] > 500
    assert robot["mean_joint_error_rad"] <= MOST_JOINT_ERROR_RAD


@pytest.mark.parametrize("motion", MOTIONS)
def test_nothing_is_lost_and_the_episode_is_good(driven: dict[str, Future[Driven]], motion: str) -> None:
    check = driven[motion].result().check
    assert {stream["key"]: stream["lost"] for stream in check["streams"] if stream["lost"]} == {}
    assert (check["dropped"], check["holes"], check["recorder_restarts"]) == (0, 0, 0)
    assert (check["is_lossless"], check["is_finished"], check["torn"]) == (True, True, None)
    assert (check["verdict"], check["reasons"]) == ("good", [])


@pytest.mark.parametrize("motion", MOTIONS)
def test_policy_gives_the_recorded_actions_again_bit_for_bit(driven: dict[str, Future[Driven]], motion: str) -> None:
    run = driven[motion].result()
    (robot,) = run.check["steps"]
    assert run.audit["steps"] == robot["steps"]
    assert (run.audit["different"], run.audit["observations"]["different"], run.audit["incomplete"]) == (0, 0, 0)
    assert run.audit["sha256"] == run.audit["recorded_sha256"]


@pytest.mark.parametrize("motion", MOTIONS)
def test_recorded_commands_move_a_fresh_simulation_alike(driven: dict[str, Future[Driven]], motion: str) -> None:
    run = driven[motion].result()
    (robot,) = run.check["steps"]
    assert run.replay["lock_step"]
    assert (run.replay["steps"], run.replay["different"], run.replay["gates_different"]) == (robot["steps"], 0, 0)
    assert run.replay["max_q_difference_rad"] == 0.0
    assert not run.replay["fell"]


@pytest.mark.parametrize("motion", MOTIONS)
def test_rehearsal_gives_the_same_figures(
    driven: dict[str, Future[Driven]], rehearsed: dict[str, dict[str, Any]], motion: str
) -> None:
    rehearsal, (robot,) = rehearsed[motion], driven[motion].result().check["steps"]
    assert not rehearsal["fell"]
    for name in ("mean_joint_error_rad", "mean_root_height_error_m"):
        assert math.isclose(rehearsal[name], robot[name], rel_tol=SAME), name


def test_all_shipped_motions_are_tried(assets: Path) -> None:
    assert sorted(f"twist2:motions/{path.name}" for path in (assets / "twist2/motions").iterdir()) == list(MOTIONS)
