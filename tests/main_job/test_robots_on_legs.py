"""A robot on legs as a user runs it, without a network: served, recorded, judged, audited, replayed and drawn."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from adapters.robots.legged.unitree import ROBOTS
from station import packages
from tests.main_job.station_runs import LOCK_STEP, Terminal
from tests.verdicts import OF_A_LATE_MACHINE

SETTINGS = [setting.replace("g1.", "robot.") for setting in LOCK_STEP]
OTHER = "h1"
"""A humanoid, by a copy of the runbook."""

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module", params=["go2", OTHER])
def stood(
    processes: None, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Terminal, str]:
    """A terminal in which a robot has stood through a clip, recorded; and the robot."""
    name, folder = request.param, tmp_path_factory.mktemp("legs")
    terminal = Terminal(folder)
    runbook = "go2-sim-stand"
    if name == OTHER:
        book = yaml.safe_load((packages.RUNBOOKS / f"{runbook}.yaml").read_text())
        book["robot"] = name
        for step in book["steps"]:
            given = step.get("with", {})
            given.update({key: value.replace("go2", name) for key, value in given.items()})
        runbook = str(folder / "copied.yaml")
        Path(runbook).write_text(yaml.safe_dump(book))
    sets = [word for setting in SETTINGS for word in ("--set", setting)]
    done = terminal.run("up", runbook, "--yes", "--record", "--task", "stand", *sets)
    assert done.returncode == 0, done.stdout + done.stderr
    return terminal, name


def episode(terminal: Terminal) -> str:
    return str(terminal.episode("stand"))


def test_its_episode_is_good_and_it_stood(stood: tuple[Terminal, str]) -> None:
    terminal, name = stood
    found = terminal.json("check", episode(terminal))
    assert {reason["rule"] for reason in found["reasons"]} <= OF_A_LATE_MACHINE, found["reasons"]
    assert found["falls"] == 0
    (robot,) = found["steps"]
    assert (robot["robot"], robot["missing_steps"]) == (name, 0)
    assert robot["steps"] > 100
    assert robot["mean_joint_error_rad"] < 0.1


def test_nothing_of_it_differs_when_it_is_computed_again(stood: tuple[Terminal, str]) -> None:
    terminal, _ = stood
    audit = terminal.json("audit", episode(terminal))
    assert audit["policy"] == "direct"
    assert audit["observations"]["compared"] == audit["steps"] > 100
    assert (audit["different"], audit["observations"]["different"]) == (0, 0)
    replay = terminal.json("replay", episode(terminal), "--to", "sim")
    assert (replay["different"], replay["fell"]) == (0, False)


def test_it_is_drawn_as_itself(stood: tuple[Terminal, str], tmp_path: Path) -> None:
    terminal, name = stood
    asked = {"--save": tmp_path / "episode.rrd"}
    if name != OTHER:  # drawing takes its time without a graphics card
        asked |= {"--contact-sheet": tmp_path / "sheet.png", "--plot": tmp_path / "plot.png"}
    for option, file in asked.items():
        done = terminal.run("view", episode(terminal), option, str(file))
        assert done.returncode == 0, done.stdout + done.stderr
        assert "not drawn" not in done.stdout + done.stderr
        assert file.stat().st_size > 50_000


def test_its_columns_have_names(stood: tuple[Terminal, str], tmp_path: Path) -> None:
    terminal, name = stood
    done = terminal.run("export", "csv", episode(terminal), "--out", str(tmp_path))
    assert done.returncode == 0, done.stdout + done.stderr
    (table,) = tmp_path.rglob(f"robot_state_{name}.csv")
    columns = table.read_text().splitlines()[0].split(",")
    assert columns[3 : 3 + len(ROBOTS[name].joints)] == [f"{joint}_pos [rad]" for joint in ROBOTS[name].joint_names]


def test_it_is_described_and_rehearsed_by_its_name(stood: tuple[Terminal, str]) -> None:
    terminal, name = stood
    said = terminal.run("describe", name).stdout
    assert said.startswith(f"{name}: unitree_{name}, {len(ROBOTS[name].joints)} joints, stands on its own")
    assert f"action_joints_{name}" in said
    (found,) = terminal.json("rehearse", "builtin:walk-forward", "--robot", f"{name}-mujoco")["motions"]
    assert found["fell"] is False
